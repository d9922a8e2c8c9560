//! Rules for vetoes of chunks by the world model's predictions.

use std::{collections::VecDeque, time::Duration};

use thiserror::Error;
use wm_msgs::wm_msgs::{ActionCandidates, Assessment, CandidateAssessment, PredictionError};

use super::{Offer, Source, offer::values};

/// Candidates and assessments that are kept: those of the last images.
const KEPT: usize = 8;

/// The rules for vetoes. 0 turns a rule off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VetoSettings {
    /// Greatest cost to the goal after the last predicted step, as a multiple of that after the first.
    pub cost_rise: f64,
    /// Least success probability.
    pub min_success: f64,
    /// Whether a chunk has to be assessed before it is begun.
    pub is_required: bool,
    /// How long a chunk may wait for its assessment.
    pub wait: Duration,
    /// Greatest mean error of the predictions, as a multiple of that of persistence.
    pub error_ratio: f64,
    /// How many of the last prediction errors that mean is over.
    pub error_window: usize,
}

/// The reason for a veto.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum Veto {
    /// It leads away from the goal.
    #[error(
        "the predicted cost becomes {rise:.2} times what it is after the first step; at most {limit} is allowed"
    )]
    CostRise {
        /// The last cost by the first.
        rise: f64,
        /// The parameter veto_cost_rise.
        limit: f64,
    },
    /// It is not likely to succeed.
    #[error("the predicted success probability is {probability:.2}; at least {limit} is expected")]
    Success {
        /// The probability.
        probability: f64,
        /// The parameter veto_min_success.
        limit: f64,
    },
    /// It was assessed, but without the figure that a rule needs.
    #[error("its assessment has no {0}, which veto_required asks for")]
    Unknown(&'static str),
    /// The model predicts poorly here.
    #[error(
        "the last {count} prediction errors are {ratio:.2} times those of persistence; at most {limit} is allowed"
    )]
    PredictionError {
        /// How many.
        count: usize,
        /// Their mean by that of persistence.
        ratio: f64,
        /// The parameter veto_error_ratio.
        limit: f64,
    },
}

/// The decision of the rules on an offer.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Verdict {
    /// It may be executed.
    Pass,
    /// It waits for its assessment.
    Unassessed,
    /// It must not be executed.
    Veto(Veto),
}

/// The figures of one candidate that rules are about.
#[derive(Clone, Copy, Debug)]
struct Figures {
    /// The last cost by the first; `None` without a goal.
    rise: Option<f64>,
    /// `None` without a probe or an instruction.
    success: Option<f64>,
}

impl Figures {
    fn of(candidate: &CandidateAssessment) -> Self {
        let costs = &candidate.step_costs;
        let ends = costs.first().copied().zip(costs.last().copied());
        let rise = ends.map(|(first, last)| f64::from(last) / f64::from(first).max(1e-12));
        let success = f64::from(candidate.success_probability);
        Self {
            rise: rise.filter(|rise| rise.is_finite()),
            success: Some(success).filter(|success| success.is_finite()),
        }
    }
}

/// The actions of each chunk of a policy's choice.
type Chunks = Vec<Vec<Vec<f32>>>;

/// The known figures of the model's predictions.
#[derive(Clone, Debug)]
pub(super) struct Vetoes {
    settings: VetoSettings,
    /// By the stamp that the chunks of one choice share \[ns\].
    candidates: VecDeque<(i64, Chunks)>,
    assessments: VecDeque<(i64, Vec<Figures>)>,
    /// Of the model and of persistence.
    errors: VecDeque<(f64, f64)>,
}

impl Vetoes {
    pub fn new(settings: VetoSettings) -> Self {
        Self {
            settings,
            candidates: VecDeque::new(),
            assessments: VecDeque::new(),
            errors: VecDeque::new(),
        }
    }

    pub fn settings(&self) -> &VetoSettings {
        &self.settings
    }

    pub fn candidates(&mut self, stamp_ns: i64, candidates: &ActionCandidates) {
        let chunks = candidates.chunks.iter();
        let actions = chunks.map(|chunk| values(&chunk.actions)).collect();
        keep(&mut self.candidates, KEPT, (stamp_ns, actions));
    }

    pub fn assessment(&mut self, stamp_ns: i64, assessment: &Assessment) {
        let figures = assessment.candidates.iter().map(Figures::of).collect();
        keep(&mut self.assessments, KEPT, (stamp_ns, figures));
    }

    /// An error that is no number says nothing, and is left out.
    pub fn prediction_error(&mut self, error: &PredictionError) {
        let (mse, persistence) = (f64::from(error.mse), f64::from(error.persistence_mse));
        if mse.is_finite() && persistence.is_finite() {
            keep(
                &mut self.errors,
                self.settings.error_window.max(1),
                (mse, persistence),
            );
        }
    }

    pub fn clear(&mut self) {
        self.candidates.clear();
        self.assessments.clear();
        self.errors.clear();
    }

    /// The decision of the rules on an offer.
    pub fn judge(&self, offer: &Offer) -> Verdict {
        if let Some(veto) = self.of_errors() {
            return Verdict::Veto(veto);
        }
        // A planner has compared its plan with others by the model itself; nobody assesses it again.
        if offer.source == Source::Plan {
            return Verdict::Pass;
        }
        let found = newest(&self.assessments, offer.stamp_ns);
        let Some(figures) = found.filter(|figures| !figures.is_empty()) else {
            return match self.settings.is_required {
                true => Verdict::Unassessed,
                false => Verdict::Pass,
            };
        };
        let candidates = newest(&self.candidates, offer.stamp_ns)
            .into_iter()
            .flatten();
        let chosen = candidates
            .zip(figures)
            .find(|(actions, _)| **actions == offer.actions);
        let veto = match chosen {
            Some((_, figures)) => self.of_figures(figures),
            // It is unknown which of them was chosen.
            None => figures.iter().find_map(|figures| self.of_figures(figures)),
        };
        veto.map_or(Verdict::Pass, Verdict::Veto)
    }

    fn of_errors(&self) -> Option<Veto> {
        let VetoSettings {
            error_ratio: limit,
            error_window,
            ..
        } = self.settings;
        let count = self.errors.len();
        if limit <= 0.0 || count < error_window.max(1) {
            return None;
        }
        let (model, persistence) = self
            .errors
            .iter()
            .fold((0.0, 0.0), |(model, persistence), error| {
                (model + error.0, persistence + error.1)
            });
        let ratio = model / f64::max(persistence, 1e-12);
        (ratio > limit).then_some(Veto::PredictionError {
            count,
            ratio,
            limit,
        })
    }

    fn of_figures(&self, figures: &Figures) -> Option<Veto> {
        let VetoSettings {
            cost_rise,
            min_success,
            is_required,
            ..
        } = self.settings;
        let unknown = |name| is_required.then_some(Veto::Unknown(name));
        let of_cost = match figures.rise {
            _ if cost_rise <= 0.0 => None,
            None => unknown("cost to a goal"),
            Some(rise) => (rise > cost_rise).then_some(Veto::CostRise {
                rise,
                limit: cost_rise,
            }),
        };
        let of_success = || match figures.success {
            _ if min_success <= 0.0 => None,
            None => unknown("success probability"),
            Some(probability) => (probability < min_success).then_some(Veto::Success {
                probability,
                limit: min_success,
            }),
        };
        of_cost.or_else(of_success)
    }
}

fn keep<T>(kept: &mut VecDeque<T>, most: usize, new: T) {
    while kept.len() >= most {
        kept.pop_front();
    }
    kept.push_back(new);
}

fn newest<T>(kept: &VecDeque<(i64, T)>, stamp_ns: i64) -> Option<&T> {
    let mut newest_first = kept.iter().rev();
    newest_first.find_map(|(of_ns, value)| (*of_ns == stamp_ns).then_some(value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::{
        builtin_interfaces::{Duration as RosDuration, Time},
        wm_msgs::{Action, ActionChunk},
    };

    const SETTINGS: VetoSettings = VetoSettings {
        cost_rise: 1.2,
        min_success: 0.3,
        is_required: false,
        wait: Duration::from_millis(300),
        error_ratio: 1.5,
        error_window: 3,
    };

    fn chunk(sway: f32) -> ActionChunk {
        let mut chunk = ActionChunk {
            period: RosDuration::from_nanos(200_000_000),
            ..ActionChunk::default()
        };
        chunk.header.stamp = Time::from_nanos(5);
        chunk.actions = vec![Action {
            values: vec![0.0, sway, 0.0, 0.0, 0.0, 0.0, 1.0],
            ..Action::default()
        }];
        chunk
    }

    fn assessed(step_costs: &[f32], success_probability: f32) -> CandidateAssessment {
        CandidateAssessment {
            step_costs: step_costs.to_vec(),
            success_probability,
            ..CandidateAssessment::default()
        }
    }

    fn vetoes(settings: VetoSettings, candidates: Vec<CandidateAssessment>) -> Vetoes {
        let mut vetoes = Vetoes::new(settings);
        vetoes.assessment(
            5,
            &Assessment {
                candidates,
                ..Assessment::default()
            },
        );
        vetoes
    }

    fn offer() -> Offer {
        Offer::of_chunk(&chunk(0.01)).unwrap()
    }

    #[test]
    fn a_rule_takes_figures_and_a_limit() {
        let good = assessed(&[0.5, 0.4], 0.9);
        assert_eq!(vetoes(SETTINGS, vec![good]).judge(&offer()), Verdict::Pass);
        let away = vetoes(SETTINGS, vec![assessed(&[0.5, 1.0], 0.9)]).judge(&offer());
        assert!(matches!(away, Verdict::Veto(Veto::CostRise { rise, .. }) if rise == 2.0));
        let fails = vetoes(SETTINGS, vec![assessed(&[], 0.1)]).judge(&offer());
        assert!(matches!(fails, Verdict::Veto(Veto::Success { .. })));
        let off = VetoSettings {
            cost_rise: 0.0,
            min_success: 0.0,
            ..SETTINGS
        };
        let judged = vetoes(off, vec![assessed(&[0.1, 1.0], 0.0)]).judge(&offer());
        assert_eq!(judged, Verdict::Pass);
    }

    #[test]
    fn what_is_required_must_be_there_and_have_the_figures() {
        let required = VetoSettings {
            is_required: true,
            ..SETTINGS
        };
        let judge = |settings, candidates| vetoes(settings, candidates).judge(&offer());
        assert_eq!(judge(SETTINGS, vec![]), Verdict::Pass);
        assert_eq!(judge(required, vec![]), Verdict::Unassessed);
        let blind = assessed(&[f32::NAN], f32::NAN);
        assert_eq!(judge(SETTINGS, vec![blind.clone()]), Verdict::Pass);
        let judged = judge(required, vec![blind]);
        assert_eq!(judged, Verdict::Veto(Veto::Unknown("cost to a goal")));
    }

    #[test]
    fn the_chosen_candidate_counts_else_the_worst() {
        let figures = vec![assessed(&[0.5], 0.1), assessed(&[0.5], 0.9)];
        let mut vetoes = vetoes(SETTINGS, figures);
        assert!(matches!(vetoes.judge(&offer()), Verdict::Veto(_)));
        let candidates = ActionCandidates {
            chunks: vec![chunk(-0.01), chunk(0.01)],
            ..ActionCandidates::default()
        };
        vetoes.candidates(5, &candidates);
        assert_eq!(vetoes.judge(&offer()), Verdict::Pass);
        let other = Offer::of_chunk(&chunk(-0.01)).unwrap();
        assert!(matches!(vetoes.judge(&other), Verdict::Veto(_)));
    }

    #[test]
    fn a_model_worse_than_persistence_vetoes_after_enough_errors() {
        let mut vetoes = Vetoes::new(SETTINGS);
        let mut tell = |mse, count| {
            for _ in 0..count {
                vetoes.prediction_error(&PredictionError {
                    mse,
                    persistence_mse: 1.0,
                    ..PredictionError::default()
                });
            }
            vetoes.judge(&offer())
        };
        assert_eq!(tell(2.0, 2), Verdict::Pass);
        assert_eq!(tell(f32::NAN, 5), Verdict::Pass);
        let veto = tell(2.0, 1);
        assert!(
            matches!(veto, Verdict::Veto(Veto::PredictionError { ratio, count: 3, .. }) if ratio == 2.0)
        );
        assert_eq!(tell(1.0, 2), Verdict::Pass);
    }
}
