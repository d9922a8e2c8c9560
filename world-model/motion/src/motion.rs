//! Motion of a robot in an interval, from actions at any rate.
//!
//! A delta takes from its stamp until the next action, or for its period. A velocity and a state (a gripper's opening,
//! a joint's position) hold until the next one. So 5, 10, 30 and 50 Hz give the same motion: translations are summed,
//! rotations composed, velocities integrated, the last state taken. An action partly inside the interval counts in
//! part.
//!
//! [`Motion`] records executed actions ([`Motion::take`]) and announced ones ([`Motion::announce`]), and computes the
//! motion between two times ([`Motion::between`]).

mod chunks;
mod executed;
mod pace;
mod piece;
pub(crate) mod rotation;

use std::sync::Arc;

use crate::actions::{ActionEncoding, ActionError, ActionSpace, ModelAction};
use chunks::ChunkTimeline;
pub use chunks::{Chunk, ChunkMerging, MAX_CHUNK};
use executed::ExecutedActions;
pub use pace::Pace;
use piece::{Piece, integrate};
pub use rotation::turn_between;

/// How long actions without a period of their own take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MotionSettings {
    /// Duration of a single action with no neighbours \[ns\].
    pub period_ns: i64,
    /// Longest duration of an action \[ns\]; after it the robot stands still.
    pub longest_ns: i64,
    /// How long actions are kept \[ns\].
    pub keep_ns: i64,
}

impl MotionSettings {
    /// Settings for a camera with `period_ns` between frames: an action takes one period, at most five periods or 1 s,
    /// and is kept for a minute.
    pub fn of_period(period_ns: i64) -> Self {
        Self {
            period_ns,
            longest_ns: period_ns.saturating_mul(5).max(1_000_000_000),
            keep_ns: 60_000_000_000,
        }
    }
}

/// Motion in an interval.
#[derive(Clone, Debug, PartialEq)]
pub struct Interval {
    /// In the units of the action space: the total change of each delta, the mean of each velocity, and the final
    /// state.
    pub values: Vec<f32>,
    /// Whether actions cover the interval. If not, the last action is held for part of it.
    pub is_given: bool,
}

/// The model action of a step, and the motion in its intervals.
#[derive(Clone, Debug, PartialEq)]
pub struct StepAction {
    /// In model units.
    pub model: ModelAction,
    /// Motion in each interval of the model's rate, oldest first.
    pub intervals: Vec<Interval>,
}

impl StepAction {
    /// Whether actions cover all of the step.
    pub fn is_given(&self) -> bool {
        self.intervals.iter().all(|interval| interval.is_given)
    }
}

/// Executed and announced actions of a robot.
#[derive(Clone, Debug)]
pub struct Motion {
    executed: ExecutedActions,
    chunks: ChunkTimeline,
}

impl Motion {
    /// No actions yet.
    pub fn new(settings: MotionSettings) -> Self {
        Self {
            executed: ExecutedActions::new(settings),
            chunks: ChunkTimeline::new(settings.keep_ns),
        }
    }

    /// Merges overlapping announcements by `merging`.
    #[must_use]
    pub fn with_merging(mut self, merging: ChunkMerging) -> Self {
        self.chunks.set_merging(merging);
        self
    }

    /// Keeps actions for `keep_ns` from now on.
    pub fn keep_for(&mut self, keep_ns: i64) {
        self.executed.keep_for(keep_ns);
        self.chunks.keep_for(keep_ns);
    }

    /// Records an executed action. One with the same stamp replaces the earlier one.
    pub fn take(&mut self, stamp_ns: i64, values: Arc<[f32]>) {
        self.executed.insert(stamp_ns, values);
    }

    /// Records announced actions. They replace or join ([`Self::with_merging`]) earlier announcements for the same
    /// time; those for an earlier time stay.
    pub fn announce(&mut self, chunk: Chunk, space: &ActionSpace) {
        self.chunks.set(chunk, space);
    }

    /// Stamp of the newest executed action.
    pub fn newest_taken_ns(&self) -> Option<i64> {
        self.executed.newest_ns()
    }

    /// Stamp of the newest announcement.
    pub fn announced_ns(&self) -> Option<i64> {
        self.chunks.stamp_ns()
    }

    /// The motion from `from_ns` to `to_ns`; `None` if no action is known at its start. Executed actions win over
    /// announced ones, and after both the last action is held.
    pub fn between(&self, space: &ActionSpace, from_ns: i64, to_ns: i64) -> Option<Interval> {
        integrate(space, &self.pieces(), from_ns, to_ns)
    }

    /// The action of the model step from `from_ns` to `to_ns`, by the model's rule over its intervals. Its velocities are
    /// those of the same motion in intervals of the model's rate ([`ActionSpace::to_nominal`]).
    ///
    /// # Errors
    /// [`ActionError::Unknown`] if no action is known at the start of an interval, and those of
    /// [`ActionEncoding::encode_step`].
    pub fn step(
        &self,
        encoding: &ActionEncoding,
        from_ns: i64,
        to_ns: i64,
    ) -> Result<StepAction, ActionError> {
        // A skip is a handful of frames.
        let skip = encoding.frame_skip().max(1) as i64;
        let at = |index: i64| from_ns + (to_ns - from_ns) / skip * index;
        let mut intervals = Vec::with_capacity(encoding.frame_skip());
        let mut nominal = Vec::with_capacity(encoding.frame_skip());
        for index in 0..skip {
            let start_ns = at(index);
            let end_ns = if index + 1 == skip {
                to_ns
            } else {
                at(index + 1)
            };
            let interval = self.between(encoding.space(), start_ns, end_ns);
            let interval = interval.ok_or(ActionError::Unknown { at_ns: start_ns })?;
            let mut values = interval.values.clone();
            let span_ns = end_ns.saturating_sub(start_ns);
            encoding.space().to_nominal(&mut values, span_ns);
            nominal.push(values);
            intervals.push(interval);
        }
        Ok(StepAction {
            model: encoding.encode_step(&nominal)?,
            intervals,
        })
    }

    /// Keeps the actions within `margin_ns` of a time that the clock jumped to.
    pub fn retain_around(&mut self, stamp_ns: i64, margin_ns: i64) {
        self.executed.retain_around(stamp_ns, margin_ns);
        self.chunks.retain_around(stamp_ns, margin_ns);
    }

    /// Forgets all actions.
    pub fn clear(&mut self) {
        self.executed.clear();
        self.chunks.clear();
    }

    /// All pieces in order, without overlap; the last one is held without end.
    fn pieces(&self) -> Vec<Piece> {
        let mut executed = self.executed.pieces();
        // An action takes until the next one, executed or announced.
        if let Some(last) = executed.last_mut()
            && let Some(next_ns) = self.chunks.start_near(last.end_ns, last.span_ns / 4)
        {
            last.end_ns = next_ns;
            last.span_ns = next_ns - last.start_ns;
        }
        let mut pieces = match (executed.first(), executed.last()) {
            (Some(first), Some(last)) => {
                let mut pieces = self.chunks.before(first.start_ns);
                let after = self.chunks.after(last.end_ns);
                pieces.extend(executed);
                pieces.extend(after);
                pieces
            }
            _ => self.chunks.after(i64::MIN),
        };
        if let Some(last) = pieces.last() {
            let held = last.held();
            pieces.push(held);
        }
        pieces
    }
}

#[cfg(test)]
mod tests;
