use anyhow::{Context as _, Result};
use candle_core::{Device, Tensor};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use wm_planner::{
    Cem, CemSettings, Coordinate, Dynamics, Objective, Planner as _, Problem, Range, Returned,
    SearchSpace, Target, TransitionDynamics,
};

use super::searched::{Searched, translations};
use crate::{Settings, Subject, Windows};

/// Candidates rolled out at once.
const BATCH: usize = 64;

/// The searches in one window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecoveredActions {
    /// Names of the searched dimensions. All errors are over these.
    pub dimensions: Vec<String>,
    /// Effect of each dimension of the action space on predictions, by name; empty unless it decided what is searched.
    pub effects: Vec<(String, f64)>,
    /// Number of steps searched together.
    pub k: usize,
    /// Cost of the true actions.
    pub cost_of_truth: f64,
    /// Error of uniformly random actions within the bounds.
    pub random_error: f64,
    /// Error of no motion.
    pub zero_error: f64,
    /// Error of the inverse dynamics model on the same latents; `None` without a model of this many steps.
    pub told_error: Option<f64>,
    /// The searches.
    pub searches: Vec<Search>,
}

/// Start of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Start {
    /// The true actions, as in the paper.
    Truth,
    /// Zero, the start of a planner on a robot.
    Zero,
}

/// A search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Search {
    /// Where it started.
    pub start: Start,
    /// Mean distance to the true action, over the steps.
    pub error: f64,
    /// The same over the translations among the dimensions; `None` without any.
    pub translation_error: Option<f64>,
    /// Mean absolute error of each dimension, over the steps.
    pub by_dimension: Vec<f64>,
    /// Cost of the result.
    pub cost: f64,
    /// Least cost of each iteration.
    pub iteration_costs: Vec<f64>,
}

/// Searches for the k actions of window `unit` from every start.
pub(super) fn measure(
    subject: &Subject,
    (settings, searched): (&Settings, &Searched),
    windows: &Windows,
    (unit, k): (usize, usize),
) -> Result<RecoveredActions> {
    let own = &settings.control;
    let action_space = subject.world.encoding.space();
    let values = searched.indices.len();
    // All candidates and searches of a window share one noise; each window has its own.
    let seed = settings.seed.wrapping_add(unit as u64);
    let (context, past) = windows.context(unit)?;
    let told = windows.actions(unit)?;
    let target = Target::EachStep(windows.coming(unit)?.narrow(0, 0, k)?.contiguous()?);
    let model = &subject.world.transition;
    // The last predicted frame carries its recorded action, which is not searched: training never had zeros there
    // (architecture.md, section 2).
    let after = told.narrow(0, k, 1)?;
    let dynamics = TransitionDynamics::new(model, subject.sampler(), &context, Some(&past), seed)?
        .ending_with(&after)?;
    let coordinates = searched.indices.iter().map(|index| Coordinate {
        index: *index,
        range: Range::Between(-own.bound, own.bound),
        rate: f32::INFINITY,
    });
    let space = SearchSpace::new(vec![0.0; dynamics.action_dim()], coordinates.collect())?;
    let whole: Vec<Vec<f32>> = told.narrow(0, 0, k)?.to_vec2()?;
    let truth: Vec<Vec<f32>> = whole.iter().map(|step| space.searched(step)).collect();
    let mut dynamics = WithRest::new(dynamics, whole, &searched.indices)?;
    let of_translations: Vec<usize> = {
        let translations = translations(action_space);
        let each = searched.indices.iter().enumerate();
        each.filter(|(_, index)| translations.contains(index))
            .map(|(position, _)| position)
            .collect()
    };

    let settings_of = CemSettings {
        population: own.population,
        iterations: own.iterations,
        elites: own.elites,
        initial_std: own.initial_std,
        returned: Returned::BestSeen,
        ..CemSettings::default()
    };
    let cem = Cem::new(settings_of)?;
    let objective = Objective::of(target.clone());
    let mut searches = Vec::new();
    for start in [Start::Truth, Start::Zero] {
        let mut problem = Problem {
            space: &space,
            dynamics: &mut dynamics,
            objective: &objective,
            horizon: k,
            batch: BATCH,
            proposals: match start {
                Start::Truth => vec![truth.clone()],
                Start::Zero => Vec::new(),
            },
            workers: None,
        };
        let plan = cem.plan(&mut problem, seed, &mut |_| false)?;
        searches.push(Search {
            start,
            error: error(&plan.actions, &truth),
            translation_error: (!of_translations.is_empty()).then(|| {
                let of = |steps: &[Vec<f32>]| only(steps, &of_translations);
                error(&of(&plan.actions), &of(&truth))
            }),
            by_dimension: by_dimension(&plan.actions, &truth),
            cost: f64::from(plan.cost),
            iteration_costs: plan.iteration_costs.iter().map(|c| f64::from(*c)).collect(),
        });
    }
    let told = told.narrow(0, 0, k)?.unsqueeze(0)?.contiguous()?;
    let rolled = dynamics.inner.rollout(&told)?;
    let cost = target.costs(&rolled)?.first().copied();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let random: Vec<Vec<f32>> = (0..k)
        .map(|_| {
            let drawn = (0..values).map(|_| rng.random_range(-own.bound..=own.bound));
            drawn.collect()
        })
        .collect();
    let name = |index: usize| {
        let dimension = action_space.dimensions().get(index);
        dimension.map_or_else(String::new, |dimension| dimension.name.clone())
    };
    let effects = searched.effects.iter().enumerate();
    Ok(RecoveredActions {
        dimensions: searched.indices.iter().map(|index| name(*index)).collect(),
        effects: effects
            .map(|(index, effect)| (name(index), *effect))
            .collect(),
        k,
        cost_of_truth: cost.map(f64::from).context("no cost of the true actions")?,
        random_error: error(&random, &truth),
        zero_error: error(&vec![vec![0.0; values]; k], &truth),
        told_error: infer_by_idm(subject, windows, unit, k)?
            .map(|told| error(&only(&told, &searched.indices), &truth)),
        searches,
    })
}

/// The model with the true values of the dimensions that are not searched.
struct WithRest<'m> {
    inner: TransitionDynamics<'m>,
    /// (k, A); zero in the searched dimensions.
    rest: Tensor,
}

impl<'m> WithRest<'m> {
    fn new(
        inner: TransitionDynamics<'m>,
        mut truth: Vec<Vec<f32>>,
        searched: &[usize],
    ) -> Result<Self> {
        for step in &mut truth {
            for index in searched {
                if let Some(value) = step.get_mut(*index) {
                    *value = 0.0;
                }
            }
        }
        Ok(Self {
            inner,
            rest: Tensor::new(truth, &Device::Cpu)?,
        })
    }
}

impl Dynamics for WithRest<'_> {
    fn action_dim(&self) -> usize {
        self.inner.action_dim()
    }

    fn start(&self) -> wm_model::Result<Tensor> {
        self.inner.start()
    }

    fn rollout(&mut self, actions: &Tensor) -> wm_model::Result<Tensor> {
        self.inner.rollout(&actions.broadcast_add(&self.rest)?)
    }
}

/// These values of each step.
fn only(steps: &[Vec<f32>], indices: &[usize]) -> Vec<Vec<f32>> {
    let of = |step: &Vec<f32>| {
        let values = indices.iter().filter_map(|index| step.get(*index));
        values.copied().collect()
    };
    steps.iter().map(of).collect()
}

/// Actions inferred from the observed latents by an inverse dynamics model of k steps.
fn infer_by_idm(
    subject: &Subject,
    windows: &Windows,
    unit: usize,
    k: usize,
) -> Result<Option<Vec<Vec<f32>>>> {
    let mut idms = subject.readers.idms.iter();
    let Some(idm) = idms.find(|idm| idm.model.idm().horizon() == k) else {
        return Ok(None);
    };
    let coming = windows.coming(unit)?.narrow(0, 0, k)?;
    let frames = Tensor::cat(&[windows.last_observed(unit)?, coming], 0)?;
    let frames = idm.latents(&frames)?;
    let told = idm.model.actions(&frames.unsqueeze(0)?)?.squeeze(0)?;
    let values = subject.world.encoding.space().len();
    Ok(Some(told.narrow(1, 0, values)?.to_vec2()?))
}

/// Mean L2 norm of the error over the steps (the paper's CEM error).
fn error(found: &[Vec<f32>], truth: &[Vec<f32>]) -> f64 {
    let steps = found.iter().zip(truth).map(|(found, truth)| {
        let pairs = found.iter().zip(truth);
        let squares: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
        squares.sqrt()
    });
    steps.sum::<f64>() / truth.len().max(1) as f64
}

fn by_dimension(found: &[Vec<f32>], truth: &[Vec<f32>]) -> Vec<f64> {
    let values = truth.first().map_or(0, Vec::len);
    let mut sums = vec![0.0; values];
    for (found, truth) in found.iter().zip(truth) {
        for (sum, (a, b)) in sums.iter_mut().zip(found.iter().zip(truth)) {
            *sum += f64::from((a - b).abs());
        }
    }
    let steps = truth.len().max(1) as f64;
    sums.iter().map(|sum| sum / steps).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_means_over_steps() {
        let truth = [vec![0.0, 0.0], vec![1.0, 1.0]];
        let found = [vec![3.0, 4.0], vec![1.0, 0.0]];
        assert_eq!(error(&found, &truth), 3.0);
        assert_eq!(by_dimension(&found, &truth), [1.5, 2.5]);
    }
}
