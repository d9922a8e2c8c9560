//! Topics of an episode's bag, and names of their values in a data set.

pub(crate) const ACTION_TOPIC: &str = "/wm/action";
pub(crate) const JOINTS_TOPIC: &str = "/joint_states";
pub(crate) const POSE_TOPIC: &str = "/arm/end_effector_pose";
pub(crate) const GRIPPER_TOPIC: &str = "/arm/gripper";
pub(crate) const INSTRUCTION_TOPIC: &str = "/task/instruction";
pub(crate) const SUCCESS_TOPIC: &str = "/task/success";

/// Names of the end effector's pose in `observation.state`.
pub(crate) const POSE_NAMES: [&str; 7] = [
    "arm.x", "arm.y", "arm.z", "arm.qx", "arm.qy", "arm.qz", "arm.qw",
];
/// Name of the gripper in `observation.state`.
pub(crate) const GRIPPER_NAME: &str = "arm.gripper";

/// Time of a frame, in ns since the first.
pub(crate) fn frame_ns(frame: u64, fps: f64) -> u64 {
    // Exact for whole rates, with one rounding; a day of frames is far below 2^53 ns.
    (frame as f64 * 1e9 / fps).round() as u64
}
