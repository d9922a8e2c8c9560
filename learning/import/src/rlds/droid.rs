//! DROID as RLDS (`droid_101` of the public release): three cameras and the arm's state at 15 Hz.
//!
//! Unlike its documentation, `steps/action` is an absolute pose, and a later command of a controller. As with annotations,
//! actions are the motions between states.

use super::{Content, Example, Pictures};
use crate::{
    ActionMapping,
    droid::states::{CAMERAS, of_states},
    episode::Camera,
    mapping::VALUES,
};

const POSE: &str = "steps/observation/cartesian_position";
const GRIPPER: &str = "steps/observation/gripper_position";
const JOINTS: &str = "steps/observation/joint_position";
/// The features of the cameras, in the order of [`CAMERAS`].
const IMAGES: [&str; 3] = [
    "steps/observation/exterior_image_1_left",
    "steps/observation/exterior_image_2_left",
    "steps/observation/wrist_image_left",
];
/// DROID is recorded at 15 Hz (arXiv 2403.12945, section 3).
const PERIOD_S: f64 = 1.0 / 15.0;
const JOINT_COUNT: usize = 7;

pub(super) fn is_droid(example: &Example) -> bool {
    example.has(POSE)
}

pub(super) fn read_content(example: &Example, mapping: &ActionMapping) -> Result<Content, String> {
    let values = example.floats(POSE)?;
    let (poses, rest) = values.as_chunks::<{ VALUES - 1 }>();
    if !rest.is_empty() {
        return Err(format!(
            "expected {POSE} as rows of {}, got {} numbers",
            VALUES - 1,
            values.len()
        ));
    }
    let grippers = example.floats(GRIPPER)?;
    if grippers.len() != poses.len() {
        return Err(format!(
            "expected {GRIPPER} for {} poses, got {}",
            poses.len(),
            grippers.len()
        ));
    }
    let states = poses.iter().zip(grippers).map(|(pose, gripper)| {
        let [x, y, z, roll, pitch, yaw] = pose.map(f64::from);
        [x, y, z, roll, pitch, yaw, f64::from(*gripper)]
    });
    let states: Vec<[f64; VALUES]> = states.collect();
    Ok(Content {
        recorded: of_states(&states, mapping, PERIOD_S),
        joints: read_joints(example)?,
    })
}

fn read_joints(example: &Example) -> Result<Option<Vec<Vec<f64>>>, String> {
    if !example.has(JOINTS) {
        return Ok(None);
    }
    let values = example.floats(JOINTS)?;
    let (rows, rest) = values.as_chunks::<JOINT_COUNT>();
    if !rest.is_empty() {
        return Err(format!(
            "expected {JOINTS} as rows of {JOINT_COUNT}, got {} numbers",
            values.len()
        ));
    }
    let row = |row: &[f32; JOINT_COUNT]| row.iter().map(|angle| f64::from(*angle)).collect();
    Ok(Some(rows.iter().map(row).collect()))
}

/// The existing cameras, by DROID's names.
pub(super) fn read_cameras(
    example: &Example,
    jpeg_quality: u8,
    notes: &mut Vec<String>,
) -> Result<Vec<Camera>, String> {
    let mut cameras = Vec::new();
    for (name, feature) in CAMERAS.iter().zip(IMAGES) {
        if !example.has(feature) {
            notes.push(format!("{name}: the camera is missing"));
            continue;
        }
        let pictures = Pictures::read(example.bytes(feature)?, jpeg_quality);
        let pictures = pictures.map_err(|reason| format!("{feature}, {reason}"))?;
        let frames = pictures.unless_flat(feature, notes);
        cameras.extend(frames.map(|frames| Camera {
            name: (*name).to_owned(),
            frames,
        }));
    }
    Ok(cameras)
}
