//! Whether a camera has stopped although frames with fresh stamps arrive.
//!
//! Two live pictures are never the same: a sensor has noise. So a camera has stopped if its picture repeats byte for byte
//! for longer than `frozen_after`. A picture that differs by noise alone may be of a still scene, or of a camera that has
//! stopped behind a lossy link: the arm's motions decide. If the arm moves and the picture does not change, the camera has
//! stopped. A still arm in front of a still scene is no fault.
//!
//! [`Stillness`] has no clock: it goes by the stamps of frames. A camera stays frozen for as long as its picture does not
//! change, also after the arm has stopped.

mod grid;
mod movement;
mod rates;

use std::{collections::VecDeque, fmt, time::Duration};

use wm_motion::actions::{ActionError, ActionSpace};

pub(crate) use grid::Grid;
use movement::{ArmMotion, Movement};
pub(super) use rates::Rates;

use super::{Repeat, repeats::JUMP_NS};

/// Actions that wait for their frame: 30 s of them at 30 Hz.
const MOST_COMING: usize = 1000;
/// A change this many times as strong as noise explains is one of the scene, not of a slow drift.
const CLEAR: f32 = 4.0;

/// Why a camera counts as frozen.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum FreezeReason {
    /// The same bytes again and again.
    SameBytes { for_s: f64 },
    /// The arm has moved, and the picture has not changed.
    ArmMotion { for_s: f64, motion: ArmMotion },
}

impl fmt::Display for FreezeReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SameBytes { for_s } => write!(
                f,
                "the camera has stopped: its picture has been the same, byte for byte, for {for_s:.1} s. Start its driver \
                 again. If it is a simulator that renders without noise, set frozen_after:=0.0 on this node"
            ),
            Self::ArmMotion { for_s, motion } => write!(
                f,
                "the camera has stopped: its picture has not changed for {for_s:.1} s, but the arm has moved by {motion}. \
                 Start the camera's driver again; if the camera is alive, check that it sees the arm, and that the arm \
                 executes its actions"
            ),
        }
    }
}

/// The state of a camera, by a frame.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sight {
    /// Difference from the frame before, noise removed: 0 (same) to 1; `None`: not measured.
    pub change: Option<f32>,
    /// How long the picture has not changed \[ns\].
    pub unchanged_ns: i64,
    /// Frames per second \[Hz\]; `None`: not known yet.
    pub rate: Option<f64>,
    /// Frames per second that differ from their predecessor \[Hz\]; `None`: not known yet.
    pub distinct_rate: Option<f64>,
    /// Whether the camera takes pictures at a steady rate, but is published faster.
    pub is_repeating: bool,
    /// Why the camera counts as frozen, if it does.
    pub frozen: Option<FreezeReason>,
}

/// Watches the pictures of a camera and the motions of the arm.
#[derive(Clone, Debug)]
pub(crate) struct Stillness {
    /// `None`: nothing counts as frozen.
    frozen_after_ns: Option<i64>,
    /// The frame before.
    before: Option<Grid>,
    /// The picture since which nothing has changed, and its stamp \[ns\].
    since: Option<(Grid, i64)>,
    newest_ns: Option<i64>,
    movement: Movement,
    /// Stamps and values of actions that are later than the newest frame: a picture may come long after its capture.
    coming: VecDeque<(i64, Vec<f32>)>,
    /// The frame by which the arm had moved \[ns\].
    moved_ns: Option<i64>,
    /// Whether frames differ clearly from the one before.
    visible: Rates,
}

impl Stillness {
    /// For an arm with actions of `space`. A `frozen_after` of zero: nothing counts as frozen.
    pub fn new(frozen_after: Duration, space: ActionSpace) -> Self {
        // 64 bits of nanoseconds hold 292 years.
        let frozen_after_ns = i64::try_from(frozen_after.as_nanos()).unwrap_or(i64::MAX);
        Self {
            frozen_after_ns: Some(frozen_after_ns).filter(|after_ns| *after_ns > 0),
            before: None,
            since: None,
            newest_ns: None,
            movement: Movement::new(space),
            coming: VecDeque::new(),
            moved_ns: None,
            visible: Rates::default(),
        }
    }

    /// Takes an action of the arm, of the stamp `stamp_ns`.
    ///
    /// # Errors
    /// [`ActionError`]: it is not of the arm's action space, and is dropped.
    pub fn action(&mut self, stamp_ns: i64, values: Vec<f32>) -> Result<(), ActionError> {
        self.movement.space().check(&values)?;
        if self.coming.len() == MOST_COMING {
            self.coming.pop_front();
        }
        self.coming.push_back((stamp_ns, values));
        Ok(())
    }

    /// Applies the actions up to a frame.
    fn move_until(&mut self, stamp_ns: i64) {
        let movement = &mut self.movement;
        self.coming.retain(|(action_ns, values)| {
            let is_coming = *action_ns > stamp_ns;
            if !is_coming {
                movement.action(values);
            }
            is_coming
        });
    }

    /// Takes a frame of the stamp `stamp_ns`, and how it compares with the last ones. `picture`: `None` if the frame
    /// was not decoded.
    pub fn frame(&mut self, stamp_ns: i64, repeat: &Repeat, picture: Option<&Grid>) -> Sight {
        let is_back = |newest_ns: i64| stamp_ns < newest_ns.saturating_sub(JUMP_NS);
        if self.newest_ns.is_some_and(is_back) {
            self.restart();
        }
        // A frame that was overtaken counts as of the newest stamp.
        let stamp_ns = self
            .newest_ns
            .map_or(stamp_ns, |newest_ns| newest_ns.max(stamp_ns));
        self.newest_ns = Some(stamp_ns);
        self.move_until(stamp_ns);
        let change = picture.map(|picture| self.picture(stamp_ns, picture));
        let since_ns = match &self.since {
            Some((_, since_ns)) => *since_ns,
            None => stamp_ns,
        };
        let motion = self.movement.greatest();
        if motion.is_none() {
            self.moved_ns = None;
        } else if self.moved_ns.is_none() {
            self.moved_ns = Some(stamp_ns);
        }
        // A new picture that was not decoded may have changed.
        let visible_ns = stamp_ns.saturating_sub(since_ns);
        let unchanged_ns = match repeat.is_repeated {
            true => visible_ns.max(repeat.since_new_ns),
            false => visible_ns,
        };
        let (rate, mut distinct_rate) = (repeat.rate, repeat.distinct_rate);
        let is_visibly = self.visible.is_repeating();
        if is_visibly {
            let visible = self.visible.distinct_rate();
            distinct_rate = distinct_rate
                .zip(visible)
                .map(|(one, other)| one.min(other));
        }
        Sight {
            change: change.flatten(),
            unchanged_ns,
            rate,
            distinct_rate,
            is_repeating: repeat.is_steady || is_visibly,
            frozen: self.freeze_reason(stamp_ns, repeat, unchanged_ns, motion),
        }
    }

    fn freeze_reason(
        &self,
        stamp_ns: i64,
        repeat: &Repeat,
        unchanged_ns: i64,
        motion: Option<ArmMotion>,
    ) -> Option<FreezeReason> {
        let after_ns = self.frozen_after_ns?;
        let seconds = |span_ns: i64| span_ns as f64 / 1e9;
        if let (Some(motion), Some(moved_ns)) = (motion, self.moved_ns)
            && stamp_ns.saturating_sub(moved_ns) > after_ns
        {
            let for_s = seconds(unchanged_ns);
            return Some(FreezeReason::ArmMotion { for_s, motion });
        }
        (repeat.since_new_ns > after_ns).then(|| FreezeReason::SameBytes {
            for_s: seconds(repeat.since_new_ns),
        })
    }

    /// Takes a picture; gives the change since the one before.
    fn picture(&mut self, stamp_ns: i64, picture: &Grid) -> Option<f32> {
        let has_changed = match &self.since {
            Some((since, _)) => picture.difference(since).strength > 1.0,
            None => true,
        };
        if has_changed {
            self.since = Some((picture.clone(), stamp_ns));
            self.movement.restart();
            self.moved_ns = None;
        }
        let difference = self
            .before
            .replace(picture.clone())
            .map(|before| picture.difference(&before));
        if let Some(difference) = difference {
            match difference.strength {
                still if still <= 1.0 => self.visible.push(stamp_ns, false),
                clear if clear > CLEAR => self.visible.push(stamp_ns, true),
                _ => self.visible.clear(),
            }
        }
        difference.map(|difference| difference.change)
    }

    /// The next frame is of another time or another camera.
    pub fn restart(&mut self) {
        (self.before, self.since, self.newest_ns, self.moved_ns) = (None, None, None, None);
        self.movement.restart();
        self.visible.clear();
    }
}

#[cfg(test)]
mod tests;
