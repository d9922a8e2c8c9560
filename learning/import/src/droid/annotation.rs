use std::{
    fs,
    path::{Component, Path, PathBuf},
};

use serde::Deserialize;

use crate::{ImportError, mapping::VALUES};

const JOINTS: usize = 7;

/// A checked annotation of an episode.
#[derive(Debug)]
pub(super) struct Annotation {
    /// Paths relative to the parent of `annotation/`.
    pub videos: Vec<PathBuf>,
    /// By frame: x y z in m, roll pitch yaw in rad, gripper 0 open to 1 closed.
    pub states: Vec<[f64; VALUES]>,
    /// By frame, in rad.
    pub joints: Option<Vec<Vec<f64>>>,
    pub instruction: Option<String>,
    pub success: Option<bool>,
}

/// The file. Other fields are ignored: latents, and the commands at 15 Hz.
#[derive(Deserialize)]
struct AnnotationFile {
    texts: Vec<String>,
    success: Option<u8>,
    video_length: usize,
    videos: Vec<VideoEntry>,
    states: Vec<Vec<f64>>,
    /// Joints and gripper, by frame.
    joints: Option<Vec<Vec<f64>>>,
    /// Joints at 15 Hz; the frames are a subset.
    #[serde(rename = "observation.state.joint_position")]
    recorded_joints: Option<Vec<Vec<f64>>>,
}

#[derive(Deserialize)]
struct VideoEntry {
    video_path: PathBuf,
}

impl Annotation {
    pub fn read(path: &Path) -> Result<Self, ImportError> {
        let bytes = fs::read(path).map_err(|source| ImportError::io(path, source))?;
        serde_json::from_slice::<AnnotationFile>(&bytes)
            .map_err(|error| error.to_string())
            .and_then(check)
            .map_err(|reason| ImportError::corrupt(path, reason))
    }
}

fn check(file: AnnotationFile) -> Result<Annotation, String> {
    let frames = file.states.len();
    if frames != file.video_length {
        return Err(format!(
            "states: expected {} rows, as video_length says, got {frames}",
            file.video_length
        ));
    }
    let states = file.states.iter().enumerate().map(|(row, state)| {
        <[f64; VALUES]>::try_from(state.as_slice()).map_err(|_| {
            format!(
                "states, row {row}: expected {VALUES} values, got {}",
                state.len()
            )
        })
    });
    let states = states.collect::<Result<_, _>>()?;
    let videos = file.videos.into_iter().map(|video| {
        let is_inside = video
            .video_path
            .components()
            .all(|part| matches!(part, Component::Normal(_)));
        if is_inside {
            Ok(video.video_path)
        } else {
            Err(format!(
                "videos: expected a path inside the data set, got {}",
                video.video_path.display()
            ))
        }
    });
    let success = match file.success {
        None => None,
        Some(0) => Some(false),
        Some(1) => Some(true),
        Some(other) => return Err(format!("success: expected 0 or 1, got {other}")),
    };
    Ok(Annotation {
        videos: videos.collect::<Result<_, _>>()?,
        states,
        joints: joints(file.joints, file.recorded_joints, frames)?,
        instruction: file.texts.into_iter().find(|text| !text.is_empty()),
        success,
    })
}

/// The joints at each frame, without the gripper; `None` if the file has none.
fn joints(
    of_frames: Option<Vec<Vec<f64>>>,
    recorded: Option<Vec<Vec<f64>>>,
    frames: usize,
) -> Result<Option<Vec<Vec<f64>>>, String> {
    let (name, rows) = match (of_frames, recorded) {
        (Some(rows), _) => ("joints", rows),
        (None, Some(rows)) => {
            // Frames are at every Nth row from the first one; the last rows may have no frame.
            let every = rows.len().div_ceil(frames.max(1)).max(1);
            let rows = rows.into_iter().step_by(every).collect();
            ("observation.state.joint_position", rows)
        }
        (None, None) => return Ok(None),
    };
    if rows.len() != frames {
        return Err(format!(
            "{name}: expected rows of {frames} frames, got {}",
            rows.len()
        ));
    }
    let rows = rows.into_iter().enumerate().map(|(row, mut values)| {
        if values.len() < JOINTS {
            return Err(format!(
                "{name}, row {row}: expected {JOINTS} joints, got {}",
                values.len()
            ));
        }
        values.truncate(JOINTS);
        Ok(values)
    });
    rows.collect::<Result<_, _>>().map(Some)
}
