//! Options of an episode.

use crate::environment::{GoalKind, ScriptedPolicy};
use crate::variety::Variety;

/// Options of an [`Episode`](crate::Episode).
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeOptions {
    /// Number of frames, at 5 Hz.
    pub frames: usize,
    /// Whether to render object and gripper masks.
    pub masks: bool,
    /// Share of failed episodes, 0 to 1. If it is not 0, every episode has one task.
    pub failures: f64,
    /// Kinds of goals that the [`Environment`](crate::Environment)'s oracle attains, one after another, instead of an
    /// operator's tasks; empty for the operator.
    pub goals: Vec<GoalKind>,
    /// Largest share of the oracle's actions that are disturbed, 0 to 1; each episode draws its own.
    pub disturbance: f64,
    /// Policies, of which one acts in an episode, for one of `goals` from the [`Environment`](crate::Environment)'s start;
    /// empty for the operator or the oracle.
    pub policies: Vec<ScriptedPolicy>,
    /// Number of objects that [`Episode::distracted`](crate::Episode::distracted) has more than the first frame; 0 for no
    /// such picture.
    pub distractors: usize,
    /// Variation between episodes.
    pub variety: Variety,
}

impl Default for EpisodeOptions {
    fn default() -> Self {
        Self {
            frames: 50,
            masks: false,
            failures: 0.0,
            goals: Vec::new(),
            disturbance: 0.0,
            policies: Vec::new(),
            distractors: 0,
            variety: Variety::default(),
        }
    }
}
