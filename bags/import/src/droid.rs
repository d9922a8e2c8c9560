//! DROID episodes as they are passed around for world models: `annotation/SPLIT/NAME.json` with the state of each
//! frame, and an mp4 of each camera, three side by side (`videos/SPLIT/NAME/0.mp4` to `2.mp4`).
//!
//! A state is the pose of the end effector in the base (x y z in m, roll pitch yaw about fixed axes in rad) and the
//! gripper (0 open to 1 closed, DROID's sense; turned round here). The frames are a part of the 15 Hz at which DROID is
//! recorded (arXiv 2403.12945, section 3); the videos say at what rate. The commands in some annotations belong to that
//! rate and not to the frames: an action here is what led from one state to the next, as in Bridge V2, and the last one
//! stands still.

mod annotation;
mod source;

use std::f64::consts::PI;
use std::path::Path;

use crate::{
    ImportError,
    episode::{Camera, Episode, Joints, Unread, VALUES},
    video::Video,
};
use annotation::Annotation;
use source::Located;

/// The cameras of DROID in the order of the videos, as its own names shortened to ROS namespaces: `exterior_1_left`,
/// `exterior_2_left`, `wrist_left`.
const CAMERAS: [&str; 3] = ["exterior_1", "exterior_2", "wrist"];
/// The joints of the Franka arm, as its description (franka_description) names them for the arm `panda`.
const JOINT_PREFIX: &str = "panda_joint";

/// The episodes below `src`.
pub(crate) fn episodes(
    src: &Path,
    jpeg_quality: u8,
) -> Result<impl Iterator<Item = Result<Unread, ImportError>>, ImportError> {
    let found = source::find(src)?;
    Ok(found.into_iter().map(move |located| {
        let unread: Unread = Box::new(move || episode(&located, jpeg_quality));
        Ok(unread)
    }))
}

fn episode(located: &Located, jpeg_quality: u8) -> Result<Episode, ImportError> {
    let annotation = Annotation::read(&located.annotation)?;
    let frames = annotation.states.len();
    let corrupt = |reason: String| ImportError::corrupt(&located.annotation, reason);
    if annotation.videos.len() != CAMERAS.len() {
        return Err(corrupt(format!(
            "videos: expected {}, got {}",
            CAMERAS.len(),
            annotation.videos.len()
        )));
    }
    let mut cameras = Vec::new();
    let mut period_s = None;
    for (name, path) in CAMERAS.iter().zip(&annotation.videos) {
        let video = Video::open(&located.root.join(path))?;
        let of_video = period(&video, frames)?;
        if *period_s.get_or_insert(of_video) != of_video {
            return Err(ImportError::corrupt(
                video.file(),
                format!(
                    "expected a frame every {period_s:?} s, as in the first video, got {of_video} s"
                ),
            ));
        }
        cameras.push(Camera {
            name: (*name).to_owned(),
            frames: video.jpegs(0..frames, jpeg_quality)?,
        });
    }
    let states: Vec<[f64; VALUES]> = annotation.states.iter().map(opening).collect();
    let names = (1..).map(|number| format!("{JOINT_PREFIX}{number}"));
    Episode {
        source: located.annotation.clone(),
        record: None,
        // From 0.01 s to 10 s, see `period`.
        period_ns: (period_s.unwrap_or_default() * 1e9).round() as u64,
        cameras,
        actions: actions(&states),
        states: states.iter().map(|state| state.map(single)).collect(),
        joints: annotation.joints.map(|positions| Joints {
            names: names.take(positions.first().map_or(0, Vec::len)).collect(),
            positions,
        }),
        instruction: annotation.instruction,
        success: annotation.success,
    }
    .check()
}

/// Seconds from frame to frame; held against the times of all frames that are taken.
fn period(video: &Video, frames: usize) -> Result<f64, ImportError> {
    let corrupt = |reason: String| ImportError::corrupt(video.file(), reason);
    let shown = video.frame_count();
    if shown < frames {
        return Err(corrupt(format!(
            "expected {frames} frames, one per state, got {shown}"
        )));
    }
    if shown > frames {
        tracing::warn!(
            video = %video.file().display(), frames = shown, states = frames,
            "frames after the last state are ignored"
        );
    }
    let period = video.time_s(1).unwrap_or(0.2);
    if !(0.01..=10.0).contains(&period) {
        return Err(corrupt(format!(
            "expected 0.1 to 100 frames per second, got one after {period} s"
        )));
    }
    for frame in 0..frames {
        let (expected, got) = (frame as f64 * period, video.time_s(frame));
        // A thousandth of a frame: times are whole ticks of the video's clock.
        if got.is_none_or(|got| (got - expected).abs() > period / 1000.0) {
            return Err(corrupt(format!(
                "frame {frame}: expected it at {expected} s, got {got:?}"
            )));
        }
    }
    Ok(period)
}

/// A state with the gripper as 0 closed to 1 open.
fn opening([x, y, z, roll, pitch, yaw, closed]: &[f64; VALUES]) -> [f64; VALUES] {
    [*x, *y, *z, *roll, *pitch, *yaw, 1.0 - closed]
}

/// What led from each state to the next.
fn actions(states: &[[f64; VALUES]]) -> Vec<[f32; VALUES]> {
    let next = states.iter().skip(1).chain(states.last());
    let from_to = states.iter().zip(next);
    from_to
        .map(|([x, y, z, roll, pitch, yaw, _], next)| {
            let [nx, ny, nz, nroll, npitch, nyaw, gripper] = *next;
            let turn = |from: f64, to: f64| wrapped(to - from);
            [
                nx - x,
                ny - y,
                nz - z,
                turn(*roll, nroll),
                turn(*pitch, npitch),
                turn(*yaw, nyaw),
                gripper,
            ]
            .map(single)
        })
        .collect()
}

/// The same angle within -pi to pi.
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(2.0 * PI) - PI
}

/// What the messages carry.
fn single(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests;
