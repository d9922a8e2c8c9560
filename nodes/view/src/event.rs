//! Events for clients' pages, as JSON. Stamps are texts: JavaScript's numbers do not hold nanoseconds since 1970.

use crate::{clip, picture::Label, scene::PlannedPath};
use serde::{Serialize, Serializer};
use wm_msgs::wm_msgs::{
    Action, ActionCandidates, ActionChunk, Assessment, Goal, Plan, Prediction, PredictionError,
};

/// The most actions shown of a plan, chunk or candidate: more than planners and policies use.
const MAX_ACTIONS: usize = 64;
/// The most values shown of an action.
const MAX_VALUES: usize = 32;
/// The most candidates with costs and terms.
const MAX_CANDIDATES: usize = 32;
/// Bytes of a name.
const MAX_NAME: usize = 120;
/// Bytes of a log record.
const MAX_TEXT: usize = 2000;
/// Larger differences mean a stamp of another clock, such as a bag's \[ns\].
const AN_HOUR_NS: u64 = 3_600_000_000_000;

/// A time \[ns\].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stamp(pub i64);

impl Serialize for Stamp {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&self.0)
    }
}

/// Consecutive actions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Actions {
    /// When the first one begins.
    begin: Stamp,
    /// Duration of each \[ms\].
    period_ms: f64,
    values: Vec<Vec<f32>>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "t", rename_all = "lowercase")]
pub(crate) enum Event {
    /// A picture arrived. Clients can request it by these fields.
    Picture {
        source: &'static str,
        stamp: Stamp,
        observed: Stamp,
        k: u8,
    },
    /// The first or last step of a rollout arrived.
    Prediction {
        stamp: Stamp,
        observed: Stamp,
        k: u32,
        horizon: u32,
        period_ms: f64,
        /// From the capture of the observation until this step was ready; `None` if the stamps come from another clock.
        latency_ms: Option<f64>,
        model: String,
    },
    /// A prediction was compared with reality.
    Error {
        stamp: Stamp,
        observed: Stamp,
        k: u32,
        mse: f32,
        persistence: f32,
        ratio: f32,
    },
    /// The robot took an action.
    Action { stamp: Stamp, values: Vec<f32> },
    /// A policy's next actions.
    Chunk { stamp: Stamp, actions: Actions },
    Plan {
        stamp: Stamp,
        actions: Actions,
        planner: String,
        cost: f32,
        iterations: Vec<f32>,
        terms: Vec<(String, f32)>,
        spread: Vec<f32>,
        candidates: u32,
        distance: f32,
        goal: Stamp,
        goal_index: u32,
        taken_ms: f64,
        cut: bool,
    },
    /// A plan's path in the camera's picture.
    Way {
        /// When the plan's first action begins.
        stamp: Stamp,
        /// From left and top, as fractions of the picture's width and height.
        points: Vec<[f32; 2]>,
    },
    /// Candidates of a policy.
    Candidates {
        stamp: Stamp,
        policy: String,
        chunks: Vec<Actions>,
    },
    /// The predicted outcomes of candidates.
    Assessment {
        stamp: Stamp,
        candidates: Stamp,
        best: i32,
        /// Cost, and probability of success.
        costs: Vec<(f32, f32)>,
        horizon: u32,
    },
    /// A goal that is not exactly one picture.
    Goal {
        stamp: Stamp,
        pictures: usize,
        latents: usize,
        instruction: String,
    },
    Log {
        stamp: Stamp,
        level: u8,
        node: String,
        text: String,
    },
}

fn milliseconds(ns: i64) -> f64 {
    ns as f64 / 1e6
}

fn values(action: &Action) -> Vec<f32> {
    clip::list(&action.values, MAX_VALUES)
}

fn actions(actions: &[Action], begin_ns: i64, period_ns: i64) -> Actions {
    Actions {
        begin: Stamp(begin_ns),
        period_ms: milliseconds(period_ns),
        values: actions.iter().take(MAX_ACTIONS).map(values).collect(),
    }
}

fn of_chunk(chunk: &ActionChunk) -> Actions {
    let begin_ns = chunk.header.stamp.to_nanos();
    actions(&chunk.actions, begin_ns, chunk.period.to_nanos())
}

impl Event {
    pub(crate) fn picture(label: &Label) -> Self {
        Self::Picture {
            source: label.source.name(),
            stamp: Stamp(label.stamp_ns),
            observed: Stamp(label.observed_ns),
            k: label.step,
        }
    }

    pub(crate) fn prediction(prediction: &Prediction) -> Self {
        let observed_ns = prediction.observed_stamp.to_nanos();
        let ready_ns = prediction.ready_stamp.to_nanos();
        let is_current = ready_ns.abs_diff(observed_ns) < AN_HOUR_NS;
        Self::Prediction {
            stamp: Stamp(prediction.header.stamp.to_nanos()),
            observed: Stamp(observed_ns),
            k: prediction.step,
            horizon: prediction.horizon,
            period_ms: milliseconds(prediction.step_period.to_nanos()),
            latency_ms: is_current.then(|| milliseconds(ready_ns.saturating_sub(observed_ns))),
            model: clip::text(&prediction.model, MAX_NAME),
        }
    }

    pub(crate) fn error(error: &PredictionError) -> Self {
        Self::Error {
            stamp: Stamp(error.header.stamp.to_nanos()),
            observed: Stamp(error.observed_stamp.to_nanos()),
            k: error.step,
            mse: error.mse,
            persistence: error.persistence_mse,
            ratio: error.ratio,
        }
    }

    pub(crate) fn action(action: &Action) -> Self {
        Self::Action {
            stamp: Stamp(action.header.stamp.to_nanos()),
            values: values(action),
        }
    }

    pub(crate) fn chunk(chunk: &ActionChunk) -> Self {
        Self::Chunk {
            stamp: Stamp(chunk.header.stamp.to_nanos()),
            actions: of_chunk(chunk),
        }
    }

    pub(crate) fn plan(plan: &Plan) -> Self {
        let stamp_ns = plan.header.stamp.to_nanos();
        let first = plan.actions.first();
        let begin_ns = first.map_or(stamp_ns, |action| action.header.stamp.to_nanos());
        let terms = plan.terms.iter().zip(&plan.term_costs);
        Self::Plan {
            stamp: Stamp(stamp_ns),
            actions: actions(&plan.actions, begin_ns, plan.period.to_nanos()),
            planner: clip::text(&plan.planner, MAX_NAME),
            cost: plan.cost,
            iterations: clip::list(&plan.iteration_costs, MAX_CANDIDATES),
            terms: terms
                .take(MAX_CANDIDATES)
                .map(|(name, cost)| (clip::text(name, MAX_NAME), *cost))
                .collect(),
            spread: clip::list(&plan.spread_costs, MAX_CANDIDATES),
            candidates: plan.candidates,
            distance: plan.distance,
            goal: Stamp(plan.goal_stamp.to_nanos()),
            goal_index: plan.goal_index,
            taken_ms: milliseconds(plan.time_taken.to_nanos()),
            cut: plan.deadline_cut,
        }
    }

    pub(crate) fn way(way: PlannedPath) -> Self {
        Self::Way {
            stamp: Stamp(way.begin_ns),
            points: way.points,
        }
    }

    pub(crate) fn candidates(candidates: &ActionCandidates) -> Self {
        let chunks = candidates.chunks.iter().take(MAX_CANDIDATES);
        Self::Candidates {
            stamp: Stamp(candidates.header.stamp.to_nanos()),
            policy: clip::text(&candidates.policy, MAX_NAME),
            chunks: chunks.map(of_chunk).collect(),
        }
    }

    pub(crate) fn assessment(assessment: &Assessment) -> Self {
        let candidates = assessment.candidates.iter().take(MAX_CANDIDATES);
        Self::Assessment {
            stamp: Stamp(assessment.header.stamp.to_nanos()),
            candidates: Stamp(assessment.candidates_stamp.to_nanos()),
            best: assessment.best,
            costs: candidates
                .map(|candidate| (candidate.cost, candidate.success_probability))
                .collect(),
            horizon: assessment.horizon,
        }
    }

    pub(crate) fn goal(goal: &Goal) -> Self {
        Self::Goal {
            stamp: Stamp(goal.header.stamp.to_nanos()),
            pictures: goal.images.len(),
            latents: goal.latents.len(),
            instruction: clip::text(&goal.instruction, MAX_TEXT),
        }
    }

    pub(crate) fn log(log: &wm_ros::Log) -> Self {
        Self::Log {
            stamp: Stamp(log.stamp.to_nanos()),
            level: log.level,
            node: clip::text(&log.name, MAX_NAME),
            text: clip::text(&log.msg, MAX_TEXT),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::{builtin_interfaces::Time, std_msgs::Header};

    fn json(event: &Event) -> serde_json::Value {
        serde_json::to_value(event).unwrap()
    }

    #[test]
    fn stamps_keep_nanoseconds_and_nan_becomes_null() {
        let error = PredictionError {
            header: Header {
                stamp: Time::from_nanos(1_732_000_000_123_456_789),
                ..Header::default()
            },
            ratio: f32::NAN,
            step: 3,
            ..PredictionError::default()
        };
        let json = json(&Event::error(&error));
        assert_eq!(json["stamp"], "1732000000123456789");
        assert_eq!((&json["t"], &json["k"]), (&"error".into(), &3.into()));
        assert!(json["ratio"].is_null());
    }

    #[test]
    fn stamps_of_another_clock_give_no_latency() {
        let of = |ready_ns| {
            let prediction = Prediction {
                ready_stamp: Time::from_nanos(ready_ns),
                observed_stamp: Time::from_nanos(1_000_000_000),
                ..Prediction::default()
            };
            json(&Event::prediction(&prediction))["latency_ms"].clone()
        };
        assert_eq!(of(1_055_000_000), 55.0);
        assert!(of(1_732_000_000_000_000_000).is_null());
    }

    #[test]
    fn lists_of_others_are_cut() {
        let action = Action {
            values: vec![0.5; 1000],
            ..Action::default()
        };
        let plan = Plan {
            actions: vec![action; 1000],
            iteration_costs: vec![1.0; 1000],
            planner: "x".repeat(100_000),
            ..Plan::default()
        };
        let text = serde_json::to_string(&Event::plan(&plan)).unwrap();
        assert!(
            text.len() < 4 * MAX_ACTIONS * MAX_VALUES + 1000,
            "{}",
            text.len()
        );
    }
}
