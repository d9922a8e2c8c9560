//! Converts DROID's states to actions, poses and joints, for annotations and RLDS.

use crate::{
    ActionMapping, GripperRange,
    episode::{Joints, Trajectory},
    mapping::{VALUES, motions},
    remedy::ValueSource,
};

/// The cameras of DROID in the order of the videos; its names shortened to ROS namespaces.
pub(crate) const CAMERAS: [&str; 3] = ["exterior_1", "exterior_2", "wrist"];
/// Joint names of the Franka arm (franka_description, arm `panda`).
const JOINT_PREFIX: &str = "panda_joint";

/// Joint angles with the arm's joint names.
pub(crate) fn joints(positions: Vec<Vec<f64>>) -> Joints {
    let names = (1..).map(|number| format!("{JOINT_PREFIX}{number}"));
    Joints {
        names: names.take(positions.first().map_or(0, Vec::len)).collect(),
        positions,
    }
}

/// Converts DROID's states, (T, 7), whose gripper is 0 open to 1 closed; an action is the motion to the next state.
pub(crate) fn of_states(
    states: &[[f64; VALUES]],
    mapping: &ActionMapping,
    period_s: f64,
) -> Trajectory {
    let gripper = mapping.gripper.unwrap_or(GripperRange::DROID);
    let metres = f64::from(mapping.translation_scale);
    let radians = f64::from(mapping.rotation_scale);
    let mapped = states.iter().map(|state| {
        let [x, y, z, roll, pitch, yaw, closed] = *state;
        let [x, y, z] = [x, y, z].map(|value| value * metres);
        let [roll, pitch, yaw] = [roll, pitch, yaw].map(|value| value * radians);
        [x, y, z, roll, pitch, yaw, gripper.opening(closed)]
    });
    let states: Vec<[f64; VALUES]> = mapped.collect();
    // Messages have single precision.
    let single = |state: &[f64; VALUES]| state.map(|value| value as f32);
    Trajectory {
        // Fits: at most 10 s.
        period_ns: (period_s * 1e9).round() as u64,
        actions: motions(&states),
        states: states.iter().map(single).collect(),
        source: ValueSource {
            gripper: Some(gripper),
            is_of_states: true,
        },
    }
}
