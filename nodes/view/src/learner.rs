//! The learner's progress, as the page shows it.

use crate::clip;
use serde::Serialize;
use wm_msgs::wm_msgs::{LearnerRound, LearnerStatus};

/// Bytes of a text.
const MAX_TEXT: usize = 600;
/// The most rounds in the curve.
const MAX_ROUNDS: usize = 100;

/// The learner's progress.
#[derive(Debug, Serialize)]
pub(crate) struct Learner {
    detail: String,
    recorded_s: f32,
    model: String,
    rounds: Vec<Round>,
}

#[derive(Debug, Serialize)]
struct Round {
    /// When it ended \[s since 1970\].
    at: i32,
    number: u32,
    ratio: f32,
    before: f32,
    accepted: bool,
}

impl Learner {
    pub(crate) fn of(status: &LearnerStatus) -> Self {
        Self {
            detail: clip::text(&status.detail, MAX_TEXT),
            recorded_s: status.recorded,
            model: clip::text(&status.model, MAX_TEXT),
            rounds: status
                .rounds
                .iter()
                .take(MAX_ROUNDS)
                .map(Round::of)
                .collect(),
        }
    }
}

impl Round {
    fn of(round: &LearnerRound) -> Self {
        Self {
            at: round.stamp.sec,
            number: round.round,
            ratio: round.ratio,
            before: round.ratio_before,
            accepted: round.accepted,
        }
    }
}
