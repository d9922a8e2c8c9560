//! Actions of each period, from the states of joints.

use thiserror::Error;
use wm_motion::{
    actions::{ActionSpace, Dimension, Kind},
    joints::{JointActions, JointSample, MissingJoint},
    motion::{Motion, MotionSettings},
};
use wm_msgs::sensor_msgs::JointState;

use super::{
    Done, Problem,
    gripper::Gripper,
    stamp::{JUMP_NS, stamp_of},
};

const WHAT: &str = "joint_states";

/// An action space of which all values come from joints, and perhaps the gripper's opening from elsewhere.
#[derive(Clone, Debug, PartialEq)]
pub struct JointSpace {
    all: ActionSpace,
    /// The dimensions that are read from joints of their names.
    of_joints: ActionSpace,
}

impl JointSpace {
    /// With `has_gripper`, the gripper has a source of its own; otherwise it is a joint like the others.
    ///
    /// # Errors
    /// A value is not one of joints.
    pub fn new(all: ActionSpace, has_gripper: bool) -> Result<Self, NotOfJoints> {
        let is_of_joints = |dimension: &Dimension| match dimension.kind {
            kind if kind.is_gripper() => !has_gripper,
            Kind::JointDelta | Kind::JointVelocity | Kind::JointPosition | Kind::Position => true,
            _ => false,
        };
        let dimensions = all.dimensions().iter();
        let (of_joints, others): (Vec<_>, Vec<_>) = dimensions
            .cloned()
            .partition(|dimension| is_of_joints(dimension));
        if others.iter().any(|dimension| !dimension.kind.is_gripper()) {
            return Err(NotOfJoints {
                space: all.to_string(),
            });
        }
        let of_joints = ActionSpace::new(all.name().to_owned(), all.rate(), of_joints);
        let of_joints = of_joints.map_err(|_| NotOfJoints {
            space: all.to_string(),
        })?;
        Ok(Self { all, of_joints })
    }
}

/// An action space with something else than joints.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "expected deltas, velocities or positions of joints, and perhaps a gripper (parameter action_space); the action space \
     is {space}"
)]
pub struct NotOfJoints {
    /// The space, in words.
    pub space: String,
}

/// The motion of the joints, and the period that it has reached.
#[derive(Clone, Debug)]
pub(super) struct Joints {
    space: JointSpace,
    joints: JointActions,
    motion: Motion,
    period_ns: i64,
    timeout_ns: i64,
    /// The beginning of the period that is not over.
    start_ns: Option<i64>,
    /// Stamp of the newest message with the first joint.
    told_ns: Option<i64>,
    /// Stamp of the newest complete state.
    newest_ns: Option<i64>,
}

impl Joints {
    pub(super) fn new(space: JointSpace, period_ns: i64, timeout_ns: i64) -> Self {
        Self {
            joints: JointActions::new(space.of_joints.clone()),
            motion: Motion::new(MotionSettings {
                period_ns,
                longest_ns: timeout_ns,
                keep_ns: period_ns.saturating_add(timeout_ns).saturating_mul(2),
            }),
            space,
            period_ns,
            timeout_ns,
            start_ns: None,
            told_ns: None,
            newest_ns: None,
        }
    }

    /// Stamp of the newest complete state.
    pub(super) fn newest_ns(&self) -> Option<i64> {
        self.newest_ns
    }

    /// The first joint that has not arrived, once others have.
    pub(super) fn missing(&self) -> Option<MissingJoint> {
        self.joints.missing()
    }

    pub(super) fn clear(&mut self) {
        self.joints.clear();
        self.motion.clear();
        (self.start_ns, self.told_ns, self.newest_ns) = (None, None, None);
    }

    /// Takes the states of joints; returns the actions of the periods that they complete.
    pub(super) fn take(
        &mut self,
        state: &JointState,
        received_ns: i64,
        gripper: &Gripper,
    ) -> Result<Vec<Result<Done, Problem>>, Problem> {
        let stamp_ns = stamp_of(WHAT, state.header.stamp, received_ns)?;
        let back_ns = match self.has_first(state) {
            // The first joint sets the times; the stamps of other publishers may lag.
            true => self.tell(stamp_ns),
            false => 0,
        };
        let taken = self.joints.take(JointSample {
            at_ns: stamp_ns,
            names: &state.name,
            positions: &state.position,
            velocities: &state.velocity,
        });
        if back_ns >= JUMP_NS {
            return Err(Problem::Jump {
                what: WHAT,
                by_s: back_ns as f64 / 1e9,
            });
        }
        let taken = taken.map_err(|late| Problem::Older {
            what: WHAT,
            before_s: late.before_ns as f64 / 1e9,
        })?;
        let Some(action) = taken else {
            return Ok(Vec::new());
        };
        self.newest_ns = Some(action.until_ns);
        if let Some(value) = action.values.iter().find(|value| !value.is_finite()) {
            self.begin(action.until_ns);
            return Err(Problem::NotFinite {
                what: WHAT,
                value: f64::from(*value),
            });
        }
        let silent_ns = action.until_ns.saturating_sub(action.stamp_ns);
        if silent_ns > self.timeout_ns {
            let from_ns = self.start_ns.unwrap_or(action.stamp_ns);
            let unknown_ns = action.until_ns.saturating_sub(from_ns);
            self.begin(action.until_ns);
            return Err(Problem::Gap {
                what: WHAT,
                periods: (unknown_ns / self.period_ns).max(1).unsigned_abs(),
                silent_s: silent_ns as f64 / 1e9,
            });
        }
        let still = vec![0.0; action.values.len()];
        self.motion.take(action.stamp_ns, action.values.into());
        // Says when that action ends; the next one takes its place.
        self.motion.take(action.until_ns, still.into());
        let mut start_ns = self.start_ns.unwrap_or(action.stamp_ns);
        let mut done = Vec::new();
        loop {
            let end_ns = start_ns.saturating_add(self.period_ns);
            if end_ns > action.until_ns {
                break;
            }
            if let Some(interval) = self.motion.between(&self.space.of_joints, start_ns, end_ns) {
                done.push(self.action(start_ns, end_ns, &interval.values, gripper));
            }
            start_ns = end_ns;
        }
        self.start_ns = Some(start_ns);
        Ok(done)
    }

    fn has_first(&self, state: &JointState) -> bool {
        let first = self.space.of_joints.dimensions().first();
        first.is_some_and(|first| state.name.contains(&first.name))
    }

    /// Takes the stamp of the first joint; returns by how much stamps went back \[ns\], and forgets all if that is a jump.
    fn tell(&mut self, stamp_ns: i64) -> i64 {
        let back_ns = self
            .told_ns
            .map_or(0, |told_ns| told_ns.saturating_sub(stamp_ns));
        if back_ns >= JUMP_NS {
            self.clear();
        }
        self.told_ns = self.told_ns.max(Some(stamp_ns));
        back_ns
    }

    /// Begins anew at a time, before which nothing is known.
    fn begin(&mut self, at_ns: i64) {
        self.motion.clear();
        self.start_ns = Some(at_ns);
    }

    fn action(
        &self,
        start_ns: i64,
        end_ns: i64,
        moved: &[f32],
        gripper: &Gripper,
    ) -> Result<Done, Problem> {
        let JointSpace { all, of_joints } = &self.space;
        let has_gripper = of_joints.len() < all.len();
        let mut moved = moved.iter();
        let mut values = Vec::with_capacity(all.len());
        for dimension in all.dimensions() {
            let value = match has_gripper && dimension.kind.is_gripper() {
                // An opening is a few digits.
                true => Some(gripper.at(end_ns).ok_or(Problem::NoGripper)? as f32),
                false => moved.next().copied(),
            };
            values.extend(value);
        }
        all.check_over(&values, self.period_ns as f64 / 1e9)?;
        Ok(Done {
            stamp_ns: start_ns,
            values,
        })
    }
}
