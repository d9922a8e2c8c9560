//! The adapter's state.

use std::time::Duration;

use nalgebra::Isometry3;
use wm_motion::joints::MissingJoint;
use wm_msgs::{
    geometry_msgs::{PoseStamped, TwistStamped},
    sensor_msgs::JointState,
    tf2_msgs::TFMessage,
};
use wm_wire::frames::{Frames, LookupError, bare, pose};

use super::{
    GripperSource, JointSpace, Problem, Speeds, gripper::Gripper, joints::Joints, period::Period,
    poses::Poses, stamp::stamp_of, twists::Twists,
};
use crate::executor::{Layout, Velocity};

/// What moves, and how that is known.
#[derive(Clone, Debug, PartialEq)]
pub enum Motions {
    /// An end effector.
    EndEffector {
        /// The source of its motions.
        source: MotionSource,
        /// The layout of motions in actions.
        layout: Layout,
        /// The greatest speeds of the arm: faster poses and twists are dropped.
        speeds: Speeds,
    },
    /// Joints, by their states.
    Joints(JointSpace),
}

/// The source of an end effector's motions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MotionSource {
    /// Velocities.
    Twist,
    /// Poses.
    Pose,
    /// Transforms.
    Frames {
        /// The robot's base.
        base: String,
        /// The end effector.
        tool: String,
    },
}

/// Settings of the adapter.
#[derive(Clone, Debug)]
pub struct Settings {
    /// What moves.
    pub motions: Motions,
    /// The frame that velocities and poses must have; empty: any.
    pub base_frame: String,
    /// Duration of an action; above zero.
    pub period: Duration,
    /// Longest time from one pose or state of joints to the next; a velocity holds for so long.
    pub timeout: Duration,
    /// Where the gripper's opening comes from.
    pub gripper: GripperSource,
}

/// An action of the robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Done {
    /// When it began \[ns\].
    pub stamp_ns: i64,
    /// Its values.
    pub values: Vec<f32>,
}

fn finite(what: &'static str, values: &[f64]) -> Result<(), Problem> {
    match values.iter().find(|value| !value.is_finite()) {
        None => Ok(()),
        Some(value) => Err(Problem::NotFinite {
            what,
            value: *value,
        }),
    }
}

/// The state of what moves.
#[derive(Clone, Debug)]
enum Course {
    EndEffector {
        path: Path,
        layout: Layout,
        speeds: Speeds,
    },
    Joints(Joints),
}

/// The state of each source of an end effector's motions.
#[derive(Clone, Debug)]
enum Path {
    Twists(Twists),
    Poses(Poses),
    Frames {
        frames: Frames,
        base: String,
        tool: String,
        poses: Poses,
    },
}

impl Course {
    fn path(&mut self) -> Option<&mut Path> {
        match self {
            Self::EndEffector { path, .. } => Some(path),
            Self::Joints(_) => None,
        }
    }
}

impl Path {
    fn clear(&mut self) {
        match self {
            Self::Twists(twists) => twists.clear(),
            Self::Poses(poses) => poses.clear(),
            Self::Frames { frames, poses, .. } => {
                frames.clear();
                poses.clear();
            }
        }
    }
}

/// The adapter's state: an arm's messages in, actions out.
pub struct AdapterStep {
    base_frame: String,
    period: Duration,
    timeout_ns: i64,
    course: Course,
    gripper: Gripper,
    done: Vec<Result<Done, Problem>>,
}

impl AdapterStep {
    /// An adapter without messages.
    pub fn new(settings: Settings) -> Self {
        // 64 bits of nanoseconds hold 292 years.
        let nanos = |duration: Duration| i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX);
        let (period_ns, timeout_ns) = (nanos(settings.period).max(1), nanos(settings.timeout));
        let course = match settings.motions {
            Motions::Joints(space) => Course::Joints(Joints::new(space, period_ns, timeout_ns)),
            Motions::EndEffector {
                source,
                layout,
                speeds,
            } => {
                let poses = |what| Poses::new(what, period_ns, timeout_ns, speeds);
                let path = match source {
                    MotionSource::Twist => Path::Twists(Twists::new(period_ns, timeout_ns)),
                    MotionSource::Pose => Path::Poses(poses("ee_pose")),
                    MotionSource::Frames { base, tool } => Path::Frames {
                        frames: Frames::default(),
                        base: bare(&base).to_owned(),
                        tool: bare(&tool).to_owned(),
                        poses: poses("tf"),
                    },
                };
                Course::EndEffector {
                    path,
                    layout,
                    speeds,
                }
            }
        };
        Self {
            course,
            base_frame: settings.base_frame,
            period: settings.period,
            timeout_ns,
            gripper: Gripper::new(settings.gripper),
            done: Vec::new(),
        }
    }

    /// The actions of completed periods, and the reasons for missing ones. Each is returned once.
    pub fn take_done(&mut self) -> Vec<Result<Done, Problem>> {
        std::mem::take(&mut self.done)
    }

    /// Takes a velocity of the end effector. It holds until the next one, at most for `timeout`.
    ///
    /// # Errors
    /// [`Problem`]: it is left out, or begins anew.
    pub fn twist(&mut self, twist: &TwistStamped, received_ns: i64) -> Result<(), Problem> {
        let what = "twist";
        self.expect_frame(what, &twist.header.frame_id)?;
        let stamp_ns = stamp_of(what, twist.header.stamp, received_ns)?;
        let (linear, angular) = (twist.twist.linear, twist.twist.angular);
        let velocity = Velocity {
            linear: [linear.x, linear.y, linear.z],
            angular: [angular.x, angular.y, angular.z],
        };
        finite(what, &velocity.linear)?;
        finite(what, &velocity.angular)?;
        let Course::EndEffector {
            path: Path::Twists(twists),
            speeds,
            ..
        } = &mut self.course
        else {
            return Ok(());
        };
        speeds.check_velocity(velocity)?;
        let over = twists.take(stamp_ns, velocity)?;
        self.end(&over);
        Ok(())
    }

    /// Takes the pose of the end effector.
    ///
    /// # Errors
    /// [`Problem`]: it is left out, or begins anew.
    pub fn pose(&mut self, pose: &PoseStamped, received_ns: i64) -> Result<(), Problem> {
        let what = "ee_pose";
        self.expect_frame(what, &pose.header.frame_id)?;
        let stamp_ns = stamp_of(what, pose.header.stamp, received_ns)?;
        let pose = pose::of_pose(&pose.pose).map_err(|error| Problem::of_pose(what, error))?;
        let Some(Path::Poses(poses)) = self.course.path() else {
            return Ok(());
        };
        let over = poses.take(stamp_ns, pose)?;
        self.end(&over);
        Ok(())
    }

    /// Takes transforms. Returns the problems of some; the others count.
    pub fn transforms(&mut self, message: &TFMessage, is_static: bool) -> Vec<Problem> {
        let Some(Path::Frames { frames, .. }) = self.course.path() else {
            return Vec::new();
        };
        let taken = message.transforms.iter().map(|one| {
            let transform = pose::of_transform(&one.transform);
            let transform = transform.map_err(|error| Problem::of_pose("tf", error))?;
            // Nobody knows when one without a stamp was received but its sender.
            let stamp_ns = stamp_of("tf", one.header.stamp, 0)?;
            let names = (&*one.header.frame_id, &*one.child_frame_id);
            Ok(frames.take(names, is_static, stamp_ns, transform)?)
        });
        taken.filter_map(Result::err).collect()
    }

    /// Follows the transforms to the newest known time; returns the pose of the end effector, if it is new and no leap.
    ///
    /// # Errors
    /// [`LookupError`] names the missing transforms.
    pub fn follow(&mut self) -> Result<Option<(i64, Isometry3<f64>)>, LookupError> {
        let Some(Path::Frames {
            frames,
            base,
            tool,
            poses,
        }) = self.course.path()
        else {
            return Ok(None);
        };
        let (stamp_ns, pose) = frames.newest(base, tool)?;
        if poses.newest_ns() == Some(stamp_ns) {
            return Ok(None);
        }
        let is_pose = match poses.take(stamp_ns, pose) {
            Ok(over) => {
                self.end(&over);
                true
            }
            Err(problem) => {
                let begins = problem.begins_anew();
                self.done.push(Err(problem));
                begins
            }
        };
        Ok(is_pose.then_some((stamp_ns, pose)))
    }

    /// Takes the opening of the gripper, 0 closed to 1 open.
    ///
    /// # Errors
    /// [`Problem`]: it is left out.
    pub fn gripper(&mut self, opening: f64, received_ns: i64) -> Result<(), Problem> {
        self.gripper.take(received_ns, opening).map(drop)
    }

    /// Takes states of joints; returns the opening of the gripper if it depends on one of them.
    ///
    /// # Errors
    /// [`Problem`]: the gripper's joint is left out. Problems of the arm's joints are among the actions.
    pub fn joints(
        &mut self,
        joints: &JointState,
        received_ns: i64,
    ) -> Result<Option<f64>, Problem> {
        // First, for the periods that end with this message.
        let opening = self.gripper.joints(joints, received_ns);
        if let Course::Joints(course) = &mut self.course {
            match course.take(joints, received_ns, &self.gripper) {
                Ok(done) => self.done.extend(done),
                Err(problem) => self.done.push(Err(problem)),
            }
        }
        opening
    }

    /// The joint that has not arrived, once others have.
    pub fn missing_joint(&self) -> Option<MissingJoint> {
        match &self.course {
            Course::Joints(joints) => joints.missing(),
            Course::EndEffector { .. } => None,
        }
    }

    /// Advances time without a message: an arm without commands stands still. Returns whether the source is silent.
    pub fn tick(&mut self, now_ns: i64) -> bool {
        let last_ns = match &mut self.course {
            Course::Joints(joints) => joints.newest_ns(),
            Course::EndEffector { path, .. } => match path {
                Path::Twists(twists) => {
                    // Until then an older one may still come.
                    let over = twists.advance(now_ns.saturating_sub(self.timeout_ns));
                    let last_ns = twists.last_ns();
                    self.end(&over);
                    last_ns
                }
                Path::Poses(poses) | Path::Frames { poses, .. } => poses.newest_ns(),
            },
        };
        last_ns.is_none_or(|last_ns| now_ns.saturating_sub(last_ns) > self.timeout_ns)
    }

    /// Drops earlier messages, because the clock was set.
    pub fn forget(&mut self) {
        match &mut self.course {
            Course::Joints(joints) => joints.clear(),
            Course::EndEffector { path, .. } => path.clear(),
        }
        self.gripper.clear();
    }

    fn expect_frame(&self, what: &'static str, actual: &str) -> Result<(), Problem> {
        let expected = &self.base_frame;
        if expected.is_empty() || bare(actual) == bare(expected) {
            return Ok(());
        }
        Err(Problem::Frame {
            what,
            expected: expected.clone(),
            actual: actual.to_owned(),
        })
    }

    fn end(&mut self, periods: &[Period]) {
        let Course::EndEffector { layout, .. } = &self.course else {
            return;
        };
        let done = periods.iter().map(|period| self.action(layout, period));
        let done: Vec<_> = done.collect();
        self.done.extend(done);
    }

    fn action(&self, layout: &Layout, period: &Period) -> Result<Done, Problem> {
        // 64 bits of nanoseconds hold 292 years.
        let period_ns = i64::try_from(self.period.as_nanos()).unwrap_or(i64::MAX);
        let gripper = match layout.has_gripper() {
            true => {
                let opening = self.gripper.at(period.start_ns.saturating_add(period_ns));
                Some(opening.ok_or(Problem::NoGripper)?)
            }
            false => None,
        };
        let seconds = self.period.as_secs_f64();
        let velocity = period.displacement.velocity(seconds);
        let values = layout.action(velocity.into(), gripper, seconds, &[]);
        layout.space().check(&values)?;
        Ok(Done {
            stamp_ns: period.start_ns,
            values,
        })
    }
}

#[cfg(test)]
mod tests;
