//! The opening of the gripper.

use std::collections::VecDeque;

use wm_msgs::sensor_msgs::JointState;

use super::{
    Problem,
    stamp::{JUMP_NS, stamp_of},
};

/// Openings that are kept: those of a second or more.
const KEPT: usize = 512;

/// The source of the gripper's opening.
#[derive(Clone, Debug, PartialEq)]
pub enum GripperSource {
    /// None: it counts as open.
    Open,
    /// A topic of openings, 0 closed to 1 open.
    Topic,
    /// A joint, and where it is when the gripper is closed and open \[rad or m\].
    Joint {
        /// Its name.
        name: String,
        /// Where it is when the gripper is closed.
        closed: f64,
        /// Where it is when the gripper is open; another place.
        open: f64,
    },
}

/// The openings of the gripper, with their times.
#[derive(Clone, Debug)]
pub(super) struct Gripper {
    source: GripperSource,
    known: VecDeque<(i64, f64)>,
}

impl Gripper {
    pub(super) fn new(source: GripperSource) -> Self {
        Self {
            source,
            known: VecDeque::new(),
        }
    }

    pub(super) fn take(&mut self, stamp_ns: i64, opening: f64) -> Result<f64, Problem> {
        let what = "gripper";
        if !opening.is_finite() {
            return Err(Problem::NotFinite {
                what,
                value: opening,
            });
        }
        let opening = opening.clamp(0.0, 1.0);
        if let Some((newest_ns, newest)) = self.known.back() {
            let before_ns = newest_ns.saturating_sub(stamp_ns);
            if before_ns == 0 {
                // Several messages have one stamp: the first counts, as of poses.
                return Ok(*newest);
            }
            if before_ns >= JUMP_NS {
                // Openings from before the clock was set do not count.
                self.known.clear();
            } else if before_ns > 0 {
                return Err(Problem::Older {
                    what,
                    before_s: before_ns as f64 / 1e9,
                });
            }
        }
        if self.known.len() >= KEPT {
            self.known.pop_front();
        }
        self.known.push_back((stamp_ns, opening));
        Ok(opening)
    }

    /// The opening by the joint's position, if the message has that joint.
    pub(super) fn joints(
        &mut self,
        joints: &JointState,
        received_ns: i64,
    ) -> Result<Option<f64>, Problem> {
        let GripperSource::Joint { name, closed, open } = &self.source else {
            return Ok(None);
        };
        let mut all = joints.name.iter().zip(&joints.position);
        let Some((_, position)) = all.find(|(other, _)| *other == name) else {
            return Ok(None);
        };
        let stamp_ns = stamp_of("joint_states", joints.header.stamp, received_ns)?;
        let opening = (position - closed) / (open - closed);
        self.take(stamp_ns, opening).map(Some)
    }

    /// The opening at a time \[ns\].
    pub(super) fn at(&self, stamp_ns: i64) -> Option<f64> {
        if self.source == GripperSource::Open {
            return Some(1.0);
        }
        let mut newest_first = self.known.iter().rev();
        newest_first.find_map(|(known_ns, opening)| (*known_ns <= stamp_ns).then_some(*opening))
    }

    pub(super) fn clear(&mut self) {
        self.known.clear();
    }
}
