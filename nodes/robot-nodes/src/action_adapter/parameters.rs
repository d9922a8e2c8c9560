//! The adapter's parameters, checked.

use std::{path::PathBuf, time::Duration};

use anyhow::{Result, ensure};

use super::{GripperSource, JointSpace, MotionSource, Motions, Settings, Speeds};
use crate::{executor::Layout, space::action_space};

/// Closed and open have to be further apart \[rad or m\].
const LEAST_TRAVEL: f64 = 1e-6;

wm_ros::parameters! {
    /// The node's parameters.
    pub(super) struct Parameters {
        /// Where motions come from: velocities (twist), poses (ee_pose), the transform from base_frame to tool_frame (tf),
        /// or the joints that the action space names (joints).
        source: &'static str = "pose",
            one_of { "twist" => "twist", "pose" => "pose", "tf" => "tf", "joints" => "joints" };
        /// Action space of the actions: a YAML or JSON file; empty: that of Bridge V2, which has no joints.
        action_space: PathBuf = "";
        /// Frame that twists and poses must have, and that actions get; empty: any. With source tf: the robot's base.
        pub(super) base_frame: String = "";
        /// With source tf: the end effector's frame.
        tool_frame: String = "";
        /// Time from one action to the next [s].
        frame_period: Duration = 0.2, in 0.005..=10.0;
        /// Longest time from one pose, transform or state of joints to the next [s]: across a longer one there is no
        /// action. A twist holds for so long.
        timeout: Duration = 0.5, in 0.01..=60.0;
        /// Greatest speed of the end effector [m/s]. A pose further from the last one than the arm can go is dropped, until
        /// several in a row stay there: the actions then begin anew. A faster twist is dropped.
        max_linear_speed: f64 = 2.0, in 1e-3..=100.0;
        /// Greatest speed of its turns [rad/s], likewise.
        max_angular_speed: f64 = 4.0, in 1e-3..=100.0;
        /// Where the gripper's opening comes from: the topic gripper, a joint of joint_states, or nowhere. It then counts as
        /// open; with source joints, it is the position of the joint with its name in the action space.
        gripper: &'static str = "none", one_of { "none" => "none", "topic" => "topic", "joint" => "joint" };
        /// With gripper joint: the joint's name.
        gripper_joint: String = "";
        /// With gripper joint: where it is when the gripper is closed [rad or m].
        gripper_closed: f64 = 0.0;
        /// With gripper joint: where it is when the gripper is open [rad or m].
        gripper_open: f64 = 1.0;
    }
}

impl Parameters {
    /// What they say.
    ///
    /// # Errors
    /// Names those that contradict each other, or the file that cannot be read.
    pub(super) fn settings(&self) -> Result<Settings> {
        let gripper = match self.gripper {
            "topic" => GripperSource::Topic,
            "joint" => self.joint()?,
            _ => GripperSource::Open,
        };
        Ok(Settings {
            motions: self.motions(gripper != GripperSource::Open)?,
            base_frame: self.base_frame.clone(),
            period: self.frame_period,
            timeout: self.timeout,
            gripper,
        })
    }

    fn motions(&self, has_gripper: bool) -> Result<Motions> {
        let space = action_space(&self.action_space)?;
        let source = match self.source {
            "joints" => return Ok(Motions::Joints(JointSpace::new(space, has_gripper)?)),
            "twist" => MotionSource::Twist,
            "tf" => {
                let (base, tool) = (&self.base_frame, &self.tool_frame);
                ensure!(
                    !base.is_empty() && !tool.is_empty() && base != tool,
                    "source is tf, base_frame is {base:?} and tool_frame is {tool:?}: expected two frames"
                );
                MotionSource::Frames {
                    base: base.clone(),
                    tool: tool.clone(),
                }
            }
            _ => MotionSource::Pose,
        };
        Ok(Motions::EndEffector {
            source,
            layout: Layout::new(space)?,
            speeds: Speeds {
                linear: self.max_linear_speed,
                angular: self.max_angular_speed,
            },
        })
    }

    fn joint(&self) -> Result<GripperSource> {
        let (name, closed, open) = (&self.gripper_joint, self.gripper_closed, self.gripper_open);
        ensure!(
            !name.is_empty(),
            "gripper is joint, but gripper_joint is empty: expected the joint's name"
        );
        ensure!(
            closed.is_finite() && open.is_finite() && (open - closed).abs() > LEAST_TRAVEL,
            "gripper_closed is {closed} and gripper_open is {open}: expected two places of the joint"
        );
        Ok(GripperSource::Joint {
            name: name.clone(),
            closed,
            open,
        })
    }
}
