//! Predictions that wait for the frame of their predicted time, and their errors once it arrives.

use std::{collections::VecDeque, sync::Arc};

use wm_msgs::{builtin_interfaces::Time, std_msgs::Header, wm_msgs::PredictionError};

use super::calibration::Comparison;
use crate::history::Frame;

/// Most predictions that wait for their frame, for any horizon.
const MAX_PENDING: usize = 8192;

/// A prediction to be compared with the frame of the predicted time.
#[derive(Clone, Debug)]
pub(super) struct Pending {
    /// The predicted time \[ns\].
    pub due_ns: i64,
    /// The observation it started from.
    pub observed: Frame,
    /// Model steps after the observation, from 1.
    pub step: u32,
    /// The predicted latent, before calibration.
    pub predicted: Arc<[f32]>,
    /// The factor of its calibration.
    pub factor: f64,
}

/// A prediction whose time has come.
#[derive(Clone, Debug)]
pub(super) struct Scored {
    /// The error of what was published.
    pub error: PredictionError,
    /// The sums for the calibration.
    pub comparison: Comparison,
    /// Stamp of the frame that was seen \[ns\].
    pub seen_ns: i64,
}

impl Pending {
    /// Compares this prediction with `seen`.
    fn score(&self, seen: &Frame) -> Scored {
        let comparison = Comparison::new(&self.observed.values, &self.predicted, &seen.values);
        let (mse, persistence_mse) = (comparison.error(self.factor), comparison.persistence());
        let error = PredictionError {
            header: Header {
                stamp: Time::from_nanos(self.due_ns),
                frame_id: seen.frame_id.to_string(),
            },
            observed_stamp: Time::from_nanos(self.observed.stamp_ns),
            step: self.step,
            mse: mse as f32,
            persistence_mse: persistence_mse as f32,
            ratio: (mse / persistence_mse) as f32,
        };
        Scored {
            error,
            comparison,
            seen_ns: seen.stamp_ns,
        }
    }
}

/// The predictions that wait.
#[derive(Clone, Debug, Default)]
pub(super) struct Scoring {
    pending: VecDeque<Pending>,
    capacity: usize,
    given_up: u64,
}

impl Scoring {
    /// Makes room for rollouts of `horizon` steps from every camera frame, `frame_skip` of which make a step: step k waits for
    /// k * frame_skip frames. Half as much again allows for lost frames.
    pub(super) fn make_room(&mut self, horizon: usize, frame_skip: usize) {
        let waiting = frame_skip * horizon * (horizon + 1) / 2 + horizon;
        self.capacity = (waiting + waiting / 2).min(MAX_PENDING);
    }

    /// Predictions dropped before their frame arrived, because too many waited.
    pub(super) fn given_up(&self) -> u64 {
        self.given_up
    }

    /// Adds a prediction; `seen` is the frame of the same time if it arrived first.
    pub(super) fn add(&mut self, pending: Pending, seen: Option<&Frame>) -> Option<Scored> {
        if let Some(seen) = seen {
            return Some(pending.score(seen));
        }
        // A rollout that was made again, with the actions that came after its frame, replaces the first.
        self.pending.retain(|other| {
            (other.step, other.observed.stamp_ns) != (pending.step, pending.observed.stamp_ns)
        });
        while self.pending.len() >= self.capacity.max(1) {
            self.pending.pop_front();
            self.given_up += 1;
        }
        self.pending.push_back(pending);
        None
    }

    /// All predictions of the time of `seen`, the earliest observation first. Predictions of earlier times, whose
    /// frame never arrived, are dropped.
    pub(super) fn seen(&mut self, seen: &Frame, tolerance_ns: i64) -> Vec<Scored> {
        let mut scored = Vec::new();
        self.pending.retain(|pending| {
            let late_ns = seen.stamp_ns - pending.due_ns;
            if late_ns.abs() <= tolerance_ns {
                scored.push(pending.score(seen));
                return false;
            }
            late_ns < 0
        });
        scored
    }

    pub(super) fn clear(&mut self) {
        self.pending.clear();
    }
}
