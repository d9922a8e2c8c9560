//! The executor's parameters, checked.

use std::{path::PathBuf, time::Duration};

use anyhow::{Result, bail, ensure};

use crate::space::action_space;

use super::{
    Begin, Bounds, Camera, ClockWatch, Deadman, EmergencyStop, Group, Joints, Layout, Limits,
    Settings, VetoSettings, Workspace,
};

/// Rounding of sums of seconds \[s\].
const ROUNDING_S: f64 = 1e-9;

wm_ros::parameters! {
    /// The node's parameters.
    pub(super) struct Parameters {
        /// Action space of chunks and plans: a YAML or JSON file; empty: that of Bridge V2.
        action_space: PathBuf = "";
        /// Frame that chunks, plans and ee_pose must have, and that commands get; empty: any, and that of the chunk or
        /// plan.
        base_frame: String = "";
        /// What is sent to the arm: velocities as twist (command/twist) or as six numbers (command/velocity), or the
        /// motion of each command period as an action (command/action). For actions of joints: where they are to be, as
        /// joint_trajectory (command/joint_trajectory).
        command_type: &'static str = "twist", one_of {
            "twist" => "twist", "velocity" => "velocity", "action" => "action", "joint_trajectory" => "joint_trajectory",
        };
        /// What is executed: a policy's chunks (action_chunk), a planner's plans (plan), or whichever is the newer.
        _source as "source": &'static str = "both", one_of {
            "chunk" => "chunk", "plan" => "plan", "both" => "both",
        };
        /// With source plan, tell others what is going to be done: each plan that is taken while the node is armed goes
        /// to action_chunk. The predictor then predicts it, and the planner plans from where it leads.
        pub(super) announce_plans: bool = false;
        /// When the first action of a chunk or plan begins: at its stamp, or when it is taken. The first actions of one
        /// that comes late are skipped, or delayed. One so late that the arm would start and stop with each is refused.
        begin: Begin = "stamp", one_of { "stamp" => Begin::Stamp, "reception" => Begin::Reception };
        /// Commands per second [Hz].
        rate: f64 = 20.0, in 1.0..=500.0;
        /// What the commands, limits and timeouts go by: real time, or the node's clock (use_sim_time), for a simulated arm
        /// that makes its own time.
        pub(super) is_clocked as "command_clock": bool = "real", one_of { "real" => false, "ros" => true };
        /// For how long after its reception a chunk or plan is executed, by the node's clock and by real time [s]. With
        /// begin reception, its stamp may not be older either.
        max_age: Duration = 2.0, in 0.01..=60.0;
        /// With use_sim_time: the arm stops when /clock has not advanced for this long of real time [s]; earlier with a
        /// short max_age, so that the arm stands still within it; max_age is at least stop_within + 2 / rate.
        clock_timeout: Duration = 1.5, in 0.05..=60.0;
        /// The arm stops when camera_state has been silent for this long, once the encoder has published it [s]. Without
        /// an encoder nothing is waited for.
        camera_timeout: Duration = 1.0, in 0.01..=60.0;
        /// How far in the future a chunk or plan may begin [s].
        max_lead: Duration = 5.0, in 0.0..=60.0;
        /// Shortest duration of one action [s].
        min_period: Duration = 0.005, in 0.001..=60.0;
        /// Longest duration of one action [s].
        max_period: Duration = 2.0, in 0.001..=60.0;
        /// Greatest translation along an axis in one interval of the action space's rate, 0.2 s for Bridge V2 [m]; in an
        /// action of another duration, in proportion. A chunk or plan beyond that is refused.
        max_translation: f64 = 0.1, in 1e-6..=10.0;
        /// Greatest rotation about an axis in the same time [rad], likewise.
        max_rotation: f64 = 0.5, in 1e-6..=10.0;
        /// Greatest linear velocity [m/s]. What is faster is slowed down.
        max_linear_velocity: f64 = 0.25, in 1e-6..=10.0;
        /// Greatest angular velocity [rad/s]. What is faster is slowed down.
        max_angular_velocity: f64 = 1.25, in 1e-6..=50.0;
        /// Greatest linear acceleration [m/s^2].
        max_linear_acceleration: f64 = 2.0, in 1e-6..=1000.0;
        /// Greatest angular acceleration [rad/s^2].
        max_angular_acceleration: f64 = 10.0, in 1e-6..=1000.0;
        /// With command_type joint_trajectory, the joints' names in joint_states and commands, in the order of the action
        /// space; empty: those of its dimensions.
        joint_names: Vec<String> = Vec::<String>::new();
        /// Greatest motion of a joint in one interval of the action space's rate [rad or m], likewise: one number for all
        /// joints, or one a joint.
        max_joint_motion: Vec<f64> = vec![0.4];
        /// Greatest velocity of a joint [rad/s or m/s]. What is faster is slowed down. One number, or one a joint.
        max_joint_velocity: Vec<f64> = vec![1.0];
        /// Greatest acceleration of a joint [rad/s^2 or m/s^2]. One number, or one a joint.
        max_joint_acceleration: Vec<f64> = vec![8.0];
        /// Least position of each joint [rad or m]. Empty: no limits.
        joint_min: Vec<f64> = Vec::<f64>::new();
        /// Greatest position of each joint [rad or m].
        joint_max: Vec<f64> = Vec::<f64>::new();
        /// How far a joint may be from where it is told to be [rad or m]. Beyond, the arm stops.
        max_joint_error: f64 = 0.2, in 1e-6..=100.0;
        /// Time within which the arm stands still once there is nothing to execute [s]. Velocities, accelerations and the
        /// rate must allow it.
        stop_within: Duration = 0.2, in 0.001..=60.0;
        /// For how long zeros are sent after a motion [s]. Then nothing is sent until the next one.
        zero_for: Duration = 0.5, in 0.0..=60.0;
        /// While not armed, try chunks and plans out: their commands go to ~/command_preview only.
        dry_run: bool = true;
        /// Be armed from the start, without a call of ~/arm: for simulated arms only. A real arm moves with the first
        /// chunk or plan that comes, whoever stands beside it.
        pub(super) arm_on_start: bool = false;
        /// Lower corner of the box that the end effector has to stay in [m]: x, y, z in base_frame. Empty: no box.
        workspace_min: Vec<f64> = Vec::<f64>::new();
        /// Upper corner of that box [m]: x, y, z.
        workspace_max: Vec<f64> = Vec::<f64>::new();
        /// No motion may leave the box, or a joint its limits, within this time [s].
        workspace_lookahead: Duration = 0.3, in 0.001..=10.0;
        /// With a box: the arm stops when ee_pose has been silent for this long, or its stamps are older [s]. With joints: likewise
        /// of joint_states. Without a stamp, the reception counts.
        pose_timeout: Duration = 0.2, in 0.001..=60.0;
        /// Move only while the topic deadman says true.
        require_deadman: bool = false;
        /// With require_deadman: the arm stops when deadman has been silent for this long [s].
        deadman_timeout: Duration = 0.3, in 0.001..=60.0;
        /// Be armed only while a publisher of emergency_stop is connected. Without this too, one that cannot be connected
        /// keeps the arm disarmed, and one that is gone disarms it.
        require_emergency_stop: bool = false;
        /// Veto a chunk whose predicted cost to the goal becomes more than this many times what it is after the first
        /// predicted step; 0: never.
        veto_cost_rise: f64 = 0.0, in 0.0..=1e6;
        /// Veto a chunk whose predicted success probability is lower; 0: never.
        veto_min_success: f64 = 0.0, in 0.0..=1.0;
        /// Begin a chunk only after its assessment has come, with the figures that the rules are about.
        veto_required: bool = false;
        /// With veto_required: how long a chunk waits for its assessment [s].
        veto_wait: Duration = 0.5, in 0.0..=60.0;
        /// Veto everything while the mean error of the last predictions is more than this many times that of the
        /// persistence baseline; 0: never.
        veto_error_ratio: f64 = 0.0, in 0.0..=1e6;
        /// Number of prediction errors in that mean.
        veto_error_window: usize = 10, in 1..=10_000;
        /// Publish what was done in each command period on action.
        pub(super) publish_action: bool = false;
    }
}

impl Parameters {
    /// What they say.
    ///
    /// # Errors
    /// Names those that contradict each other, or the file that cannot be read.
    pub(super) fn settings(&self, is_simulated: bool) -> Result<Settings> {
        let space = action_space(&self.action_space)?;
        let moves_joints = self.command_type == "joint_trajectory";
        let layout = match moves_joints {
            true => Layout::of_joints(space)?,
            false => Layout::new(space)?,
        };
        let limits = match moves_joints {
            true => self.joint_limits(layout.axes())?,
            false => Limits::end_effector(
                (self.max_linear_velocity, self.max_linear_acceleration),
                (self.max_angular_velocity, self.max_angular_acceleration),
            ),
        };
        let period = Duration::from_secs_f64(self.rate.recip());
        let stop_s = limits.stopping_time() + period.as_secs_f64();
        ensure!(
            stop_s <= self.stop_within.as_secs_f64() + ROUNDING_S,
            "from the greatest velocities the arm takes {stop_s:.3} s to stop (max_*_velocity / max_*_acceleration + 1 / \
             rate), but stop_within is {} s: raise it or the accelerations, or lower the velocities",
            self.stop_within.as_secs_f64()
        );
        let least_s = self.stop_within.as_secs_f64() + 2.0 * period.as_secs_f64();
        ensure!(
            !is_simulated || self.max_age.as_secs_f64() + ROUNDING_S >= least_s,
            "max_age is {} s and stop_within is {} s: expected max_age to be at least {least_s:.3} s (stop_within + 2 / rate), \
             since with use_sim_time the arm has to stand still within max_age once /clock stops; raise max_age, or lower \
             stop_within",
            self.max_age.as_secs_f64(),
            self.stop_within.as_secs_f64()
        );
        ensure!(
            !(self.arm_on_start && self.require_emergency_stop),
            "arm_on_start and require_emergency_stop are both set; expected one of them: arm_on_start is for simulated arms, \
             and arms before a publisher can be connected"
        );
        ensure!(
            self.min_period <= self.max_period,
            "min_period is {} s, more than max_period, {} s",
            self.min_period.as_secs_f64(),
            self.max_period.as_secs_f64()
        );
        Ok(Settings {
            base_frame: self.base_frame.clone(),
            period,
            bounds: Bounds {
                translation: self.max_translation,
                rotation: self.max_rotation,
                joints: match moves_joints {
                    true => per_joint("max_joint_motion", &self.max_joint_motion, layout.axes())?,
                    false => Vec::new(),
                },
                // Rates are 0.01 Hz to 1 kHz.
                interval: Duration::from_secs_f64(layout.space().rate().recip()),
                periods: self.min_period..=self.max_period,
            },
            workspace: self.workspace(moves_joints, period)?,
            joints: self.joints(&layout, &limits, period)?,
            layout,
            limits,
            max_age: self.max_age,
            begin: self.begin,
            max_lead: self.max_lead,
            stop_within: self.stop_within,
            zero_for: self.zero_for,
            dry_run: self.dry_run,
            deadman: self
                .require_deadman
                .then(|| Deadman::new(self.deadman_timeout)),
            clock: ClockWatch::new(self.clock_timeout(period)),
            camera: Camera::new(self.camera_timeout),
            emergency: EmergencyStop::new(self.require_emergency_stop),
            veto: VetoSettings {
                cost_rise: self.veto_cost_rise,
                min_success: self.veto_min_success,
                is_required: self.veto_required,
                wait: self.veto_wait,
                error_ratio: self.veto_error_ratio,
                error_window: self.veto_error_window,
            },
        })
    }

    /// How long /clock may stand still.
    pub(super) fn clock_timeout(&self, period: Duration) -> Duration {
        ClockWatch::timeout_for(self.clock_timeout, self.max_age, self.stop_within, period)
    }

    fn joint_limits(&self, joints: usize) -> Result<Limits> {
        let velocities = per_joint("max_joint_velocity", &self.max_joint_velocity, joints)?;
        let accelerations = per_joint(
            "max_joint_acceleration",
            &self.max_joint_acceleration,
            joints,
        )?;
        let both = velocities.into_iter().zip(accelerations);
        let groups = both.map(|(velocity, acceleration)| Group {
            axes: 1,
            velocity,
            acceleration,
        });
        Ok(Limits::new(groups.collect()))
    }

    fn joints(&self, layout: &Layout, limits: &Limits, period: Duration) -> Result<Option<Joints>> {
        let Some(dimensions) = layout.joint_names() else {
            return Ok(None);
        };
        let count = dimensions.len();
        let names = match self.joint_names.as_slice() {
            [] => dimensions,
            names => names.to_vec(),
        };
        ensure!(
            names.len() == count,
            "joint_names has {} names; expected {count}, as the action space has joints",
            names.len()
        );
        let (least, most) = (&self.joint_min, &self.joint_max);
        let places = match (least.is_empty(), most.is_empty()) {
            (true, true) => vec![(f64::NEG_INFINITY, f64::INFINITY); count],
            _ => {
                ensure!(
                    least.len() == count && most.len() == count,
                    "joint_min has {} numbers and joint_max has {}; expected {count} in both, or none",
                    least.len(),
                    most.len()
                );
                least.iter().copied().zip(most.iter().copied()).collect()
            }
        };
        for (name, (least, most)) in names.iter().zip(&places) {
            ensure!(
                least < most,
                "{name} may be from {least} to {most}: expected numbers, the lower one first"
            );
        }
        self.expect_lookahead(limits.stopping_time(), period)?;
        Ok(Some(Joints::new(
            names,
            places,
            self.workspace_lookahead,
            self.pose_timeout,
            self.max_joint_error,
        )))
    }

    /// Whether what slows down within `workspace_lookahead` of a limit stops there.
    fn expect_lookahead(&self, stopping_s: f64, period: Duration) -> Result<()> {
        let stop_s = stopping_s + period.as_secs_f64();
        let lookahead_s = self.workspace_lookahead.as_secs_f64();
        ensure!(
            lookahead_s + ROUNDING_S >= stop_s,
            "workspace_lookahead is {lookahead_s} s, but the arm takes {stop_s:.3} s to stop (the greatest velocity / \
             acceleration + 1 / rate)"
        );
        Ok(())
    }

    fn workspace(&self, moves_joints: bool, period: Duration) -> Result<Option<Workspace>> {
        let (least, most) = (&self.workspace_min[..], &self.workspace_max[..]);
        let (least, most) = match (least, most) {
            ([], []) => return Ok(None),
            ([ax, ay, az], [bx, by, bz]) => ([*ax, *ay, *az], [*bx, *by, *bz]),
            _ => bail!(
                "workspace_min has {} numbers and workspace_max has {}; expected x, y and z in both, or none",
                least.len(),
                most.len()
            ),
        };
        ensure!(
            !moves_joints,
            "a workspace box is set, but command_type is joint_trajectory: expected joint_min and joint_max"
        );
        ensure!(
            !self.base_frame.is_empty(),
            "a workspace box is set, but base_frame is empty: expected the frame of the box and of ee_pose"
        );
        let sides = least.into_iter().zip(most);
        for (axis, (least, most)) in ["x", "y", "z"].into_iter().zip(sides) {
            ensure!(
                least.is_finite() && most.is_finite() && least < most,
                "the workspace box goes from {least} to {most} along {axis}: expected finite numbers, the lower one first"
            );
        }
        self.expect_lookahead(
            self.max_linear_velocity / self.max_linear_acceleration,
            period,
        )?;
        Ok(Some(Workspace::new(
            least,
            most,
            self.workspace_lookahead,
            self.pose_timeout,
        )))
    }
}

/// One number a joint, above zero: one for all, or one for each.
fn per_joint(name: &str, numbers: &[f64], joints: usize) -> Result<Vec<f64>> {
    ensure!(
        numbers
            .iter()
            .all(|number| number.is_finite() && *number > 0.0),
        "{name} is {numbers:?}: expected finite numbers above zero"
    );
    match numbers {
        [one] => Ok(vec![*one; joints]),
        each if each.len() == joints => Ok(each.to_vec()),
        each => bail!("{name} has {} numbers; expected 1 or {joints}", each.len()),
    }
}
