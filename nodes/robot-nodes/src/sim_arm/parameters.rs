//! The simulated arm's parameters.

use std::{num::NonZeroUsize, time::Duration};

use wm_ros::{Field, Parameter};
use wm_sim::GoalKind;
use wm_wire::transport::Transports;

use super::{CameraSettings, Settings};

/// The parameter `task`, which can be changed while the node runs.
pub(super) struct Task(Parameter<String>);

impl Task {
    /// The present value.
    fn get(&self) -> GoalKind {
        // The choices are the names of tasks.
        self.0.get().parse().unwrap_or(GoalKind::Reach)
    }
}

impl Field for Task {
    type Ros = String;
    const IS_READ_ONLY: bool = false;
    const CHOICES: &'static [&'static str] = &["reach", "push", "pick-place"];

    fn read(parameter: Parameter<String>) -> Option<Self> {
        Some(Self(parameter))
    }
}

wm_ros::parameters! {
    /// The node's parameters.
    pub(super) struct Parameters {
        /// What is to be done. What it is changed to holds from the next call of ~/reset on.
        task: Task = "reach";
        /// Seed of the table, the goal and the camera's faults, until a call of ~/reset names another.
        seed: u64 = 0;
        /// The goal is told by pictures so far apart on the way there [s], one after the other; 0: by the last one alone.
        goal_period: f64 = 0.0, in 0.0..=60.0;
        /// How fast time goes: 1 is real time, by the node's clock. Otherwise the node makes the time and tells it on
        /// /clock, for nodes with use_sim_time: 0.5 is half as fast, and 0 as fast as the commands come, one step for each
        /// twist, velocity or action.
        pub(super) real_time_factor: f64 = 1.0, in 0.0..=100.0;
        /// For how long after its reception a command holds [s]. Then the arm stands still. With real_time_factor 0 also
        /// for how long, in real time, a step waits for its command.
        command_timeout: Duration = 0.5, in 0.001..=60.0;
        /// Publish what was done in each step on action.
        _publish_action as "publish_action": bool = true;
        /// Frame of what is published, and the only one that commands may name; empty: they may name any.
        base_frame: String = wm_sim::BASE_FRAME;
        /// Frame of the tool on /tf.
        pub(super) tool_frame: String = "tool";
        /// A second camera, in front of the arm, on /front_camera/image_raw.
        front_camera: bool = false;
        /// Image transport of the cameras and of the goal.
        pub(super) image_transport: Transports = "both";
        /// Standard deviation of the cameras' noise [grey level], the same for each seed. A real sensor has about 1. At
        /// 0, the picture of an arm that stands still repeats exactly, which the encoder takes for a camera that has
        /// stopped (frozen_after).
        noise: f64 = 1.0, in 0.0..=255.0;
        /// Time from a picture's stamp to its publication [s].
        latency: Duration = 0.0, in 0.0..=5.0;
        /// Share of the pictures that are lost.
        drop: f64 = 0.0, in 0.0..=1.0;
    }
}

impl Parameters {
    /// The settings of the step.
    pub(super) fn settings(&self) -> Settings {
        Settings {
            task: self.task(),
            seed: self.seed,
            command_timeout: self.command_timeout,
            base_frame: self.base_frame.clone(),
            // A cast saturates; the range keeps it small.
            goal_every: NonZeroUsize::new((self.goal_period / wm_sim::STEP_S).round() as usize),
            camera: CameraSettings {
                noise: self.noise,
                latency: self.latency,
                drop: self.drop,
            },
            has_front_camera: self.front_camera,
        }
    }

    /// The task of the next reset.
    pub(super) fn task(&self) -> GoalKind {
        self.task.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tasks_are_those_of_the_simulator() {
        let names: Vec<_> = GoalKind::ALL.iter().map(|kind| kind.name()).collect();
        assert_eq!(names, Task::CHOICES);
    }
}
