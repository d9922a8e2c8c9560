//! Actions as motion over time.
//!
//! An action is not a sample but a motion: a delta takes from its stamp until the next action, or for its period; a
//! velocity and a state (a gripper's opening, a joint's position) hold until the next one. What a robot does in an
//! interval is thus the same at 5, 10, 30 or 50 Hz: translations are summed, rotations composed, velocities integrated,
//! the last state taken, and an action that lies in the interval in part counts in part.
//!
//! [`Motion`] keeps what was taken ([`Motion::take`]) and what is announced ([`Motion::announce`]), and answers what
//! happens between two moments ([`Motion::between`]). It knows no clock: stamps are nanoseconds of whatever clock stamped
//! frames and actions. Nodes, env, evaluation and training all go through it.
//!
//! ```
//! use wm_motion::{actions::ActionSpace, motion::{Motion, MotionSettings}};
//!
//! let space = ActionSpace::bridge();
//! let mut motion = Motion::new(MotionSettings::of_period(33_333_333));
//! for tick in 0..12_i64 {
//!     // 1 mm along x, thirty times a second.
//!     motion.take(tick * 33_333_333, [0.001, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0].into());
//! }
//! let interval = motion.between(&space, 0, 200_000_000).expect("actions are known there");
//! assert!((interval.values[0] - 0.006).abs() < 1e-6);
//! ```

mod announced;
mod pace;
mod piece;
pub(crate) mod rotation;
mod taken;

use std::sync::Arc;

use crate::actions::{ActionEncoding, ActionError, ActionSpace, ModelAction};
use announced::Announced;
pub use announced::{Chunk, ChunkMerging, MAX_CHUNK};
pub use pace::Pace;
use piece::{Piece, integrate};
pub use rotation::turn_between;
use taken::Taken;

/// How actions without a period of their own become motions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MotionSettings {
    /// How long a single action takes that nothing follows and nothing came before \[ns\].
    pub period_ns: i64,
    /// Longest time that an action takes until the next one \[ns\]; a delta that is older has come to its end, and the
    /// robot stands still.
    pub longest_ns: i64,
    /// How far back actions are kept \[ns\].
    pub keep_ns: i64,
}

impl MotionSettings {
    /// Settings for a camera with `period_ns` between frames: an action takes as long, at most a second or five
    /// periods, and a minute of them is kept.
    pub fn of_period(period_ns: i64) -> Self {
        Self {
            period_ns,
            longest_ns: period_ns.saturating_mul(5).max(1_000_000_000),
            keep_ns: 60_000_000_000,
        }
    }
}

/// What happens in an interval.
#[derive(Clone, Debug, PartialEq)]
pub struct Interval {
    /// The change over the whole interval of each delta, the mean over its time of each velocity, and each state at its
    /// end, in the units of the action space.
    pub values: Vec<f32>,
    /// Whether actions speak of all of the interval. Otherwise the last one is assumed to go on in part of it.
    pub is_given: bool,
}

/// What happens in a model step: its model action and what that was made of.
#[derive(Clone, Debug, PartialEq)]
pub struct StepAction {
    /// In model units.
    pub model: ModelAction,
    /// What happens in each interval of the model's rate, oldest first.
    pub intervals: Vec<Interval>,
}

impl StepAction {
    /// Whether actions speak of all of the step.
    pub fn is_given(&self) -> bool {
        self.intervals.iter().all(|interval| interval.is_given)
    }
}

/// The actions of a robot as motion: what was taken, and what is announced after that.
#[derive(Clone, Debug)]
pub struct Motion {
    taken: Taken,
    announced: Announced,
}

impl Motion {
    /// No motion is known yet.
    pub fn new(settings: MotionSettings) -> Self {
        Self {
            taken: Taken::new(settings),
            announced: Announced::new(settings.keep_ns),
        }
    }

    /// The same, where overlapping announcements join by `merging`.
    #[must_use]
    pub fn with_merging(mut self, merging: ChunkMerging) -> Self {
        self.announced.set_merging(merging);
        self
    }

    /// From now on, keeps actions as far back as `keep_ns`.
    pub fn keep_for(&mut self, keep_ns: i64) {
        self.taken.keep_for(keep_ns);
        self.announced.keep_for(keep_ns);
    }

    /// Takes note of an action that the robot took. One of the same stamp replaces the one before.
    pub fn take(&mut self, stamp_ns: i64, values: Arc<[f32]>) {
        self.taken.insert(stamp_ns, values);
    }

    /// Takes note of actions to come. They replace what was announced for the same time, or join it
    /// ([`Self::with_merging`]); what was announced for the time before stays.
    pub fn announce(&mut self, chunk: Chunk, space: &ActionSpace) {
        self.announced.set(chunk, space);
    }

    /// Stamp of the newest action that was taken.
    pub fn newest_taken_ns(&self) -> Option<i64> {
        self.taken.newest_ns()
    }

    /// Stamp of the newest announcement.
    pub fn announced_ns(&self) -> Option<i64> {
        self.announced.stamp_ns()
    }

    /// What happens from `from_ns` to `to_ns`; none where nothing is known of its beginning. What was taken wins over
    /// what was announced, and beyond both the last action is held.
    pub fn between(&self, space: &ActionSpace, from_ns: i64, to_ns: i64) -> Option<Interval> {
        integrate(space, &self.pieces(), from_ns, to_ns)
    }

    /// The action of the model step from `from_ns` to `to_ns`: what happens in each interval of the model's rate, and the
    /// model's own rule over them.
    ///
    /// # Errors
    /// [`ActionError::Unknown`] where nothing is known of an interval's beginning, and those of
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
        for index in 0..skip {
            let start_ns = at(index);
            let end_ns = if index + 1 == skip {
                to_ns
            } else {
                at(index + 1)
            };
            let interval = self.between(encoding.space(), start_ns, end_ns);
            intervals.push(interval.ok_or(ActionError::Unknown { at_ns: start_ns })?);
        }
        let values: Vec<&[f32]> = intervals
            .iter()
            .map(|interval| interval.values.as_slice())
            .collect();
        Ok(StepAction {
            model: encoding.encode_step(&values)?,
            intervals,
        })
    }

    /// Keeps what lies within `margin_ns` of a moment that time jumped to.
    pub fn retain_around(&mut self, stamp_ns: i64, margin_ns: i64) {
        self.taken.retain_around(stamp_ns, margin_ns);
        self.announced.retain_around(stamp_ns, margin_ns);
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.taken.clear();
        self.announced.clear();
    }

    /// All pieces in order and without overlap, the last one held without end.
    fn pieces(&self) -> Vec<Piece> {
        let mut taken = self.taken.pieces();
        // An action takes until the next one, be that taken or announced.
        if let Some(last) = taken.last_mut()
            && let Some(next_ns) = self.announced.start_near(last.end_ns, last.span_ns / 4)
        {
            last.end_ns = next_ns;
            last.span_ns = next_ns - last.start_ns;
        }
        let mut pieces = match (taken.first(), taken.last()) {
            (Some(first), Some(last)) => {
                let mut pieces = self.announced.before(first.start_ns);
                let after = self.announced.after(last.end_ns);
                pieces.extend(taken);
                pieces.extend(after);
                pieces
            }
            _ => self.announced.after(i64::MIN),
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
