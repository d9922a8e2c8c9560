//! DROID episodes in the layout for world models: `annotation/SPLIT/NAME.json` with the state of each frame, and an mp4 of
//! each of the three cameras (`videos/SPLIT/NAME/0.mp4` to `2.mp4`).
//!
//! A state is the pose of the end effector in the base (x y z in m, roll pitch yaw about fixed axes in rad) and the gripper
//! (DROID: 0 open to 1 closed; inverted here). The frames are a subset of DROID's 15 Hz (arXiv 2403.12945, section 3); the
//! videos have their rate. Commands in some annotations are at 15 Hz and ignored: as in Bridge V2, an action is the motion
//! from one state to the next, and the last action is zero.

mod annotation;
mod source;
pub(crate) mod states;

use std::path::Path;

use crate::{
    ActionMapping, ImportError,
    episode::{Camera, Episode, FoundEpisode, Trajectory, UnreadEpisode},
    origin::origin,
    video::Video,
};
use annotation::Annotation;
use source::AnnotationPath;
use states::{CAMERAS, joints, of_states};

/// Frame period of a video with a single frame.
const DEFAULT_PERIOD_S: f64 = 0.2;

/// The episodes below `src`.
pub(crate) fn episodes(
    src: &Path,
    jpeg_quality: u8,
) -> Result<impl Iterator<Item = FoundEpisode> + use<>, ImportError> {
    let found = source::find(src)?;
    Ok(found.into_iter().map(move |located| {
        let unread: Box<dyn UnreadEpisode> = Box::new(AnnotatedEpisode {
            located,
            jpeg_quality,
        });
        Ok(unread)
    }))
}

/// An annotated episode that has not been read.
struct AnnotatedEpisode {
    located: AnnotationPath,
    jpeg_quality: u8,
}

impl AnnotatedEpisode {
    fn annotation(&self) -> Result<Annotation, ImportError> {
        let annotation = Annotation::read(&self.located.annotation)?;
        if annotation.videos.len() == CAMERAS.len() {
            return Ok(annotation);
        }
        let reason = format!(
            "videos: expected {}, got {}",
            CAMERAS.len(),
            annotation.videos.len()
        );
        Err(ImportError::corrupt(&self.located.annotation, reason))
    }
}

impl UnreadEpisode for AnnotatedEpisode {
    fn origin(&self, src: &Path) -> String {
        origin(src, Some(&self.located.annotation), None)
    }

    fn recorded(&self, mapping: &ActionMapping) -> Result<Trajectory, ImportError> {
        let annotation = self.annotation()?;
        let frames = annotation.states.len();
        let mut period_s = DEFAULT_PERIOD_S;
        if let Some(first) = annotation.videos.first() {
            let video = Video::open(&self.located.root.join(first))?;
            period_s = check_timing(&video, frames)?.period_s;
        }
        Ok(of_states(&annotation.states, mapping, period_s))
    }

    fn read(&self, mapping: &ActionMapping) -> Result<Episode, ImportError> {
        let annotation = self.annotation()?;
        let frames = annotation.states.len();
        let (mut cameras, mut notes, mut period_s) = (Vec::new(), Vec::new(), None);
        for (name, path) in CAMERAS.iter().zip(&annotation.videos) {
            let video = Video::open(&self.located.root.join(path))?;
            let VideoTiming {
                period_s: of_video,
                note,
            } = check_timing(&video, frames)?;
            notes.extend(note);
            let expected = *period_s.get_or_insert(of_video);
            if expected != of_video {
                let reason = format!(
                    "expected a frame every {expected} s, as in the first video, got {of_video} s"
                );
                return Err(ImportError::corrupt(video.file(), reason));
            }
            cameras.push(Camera {
                name: (*name).to_owned(),
                frames: video.jpegs(0..frames, self.jpeg_quality)?,
            });
        }
        let period_s = period_s.unwrap_or(DEFAULT_PERIOD_S);
        notes.dedup();
        Episode {
            source: self.located.annotation.clone(),
            recorded: of_states(&annotation.states, mapping, period_s),
            cameras,
            joints: annotation.joints.map(joints),
            instruction: annotation.instruction,
            success: annotation.success,
            notes,
        }
        .check()
    }
}

/// The frame times of a video.
struct VideoTiming {
    /// Frame period.
    period_s: f64,
    /// Peculiarities.
    note: Option<String>,
}

/// Checks that a video has a frame per state, at a constant rate.
fn check_timing(video: &Video, frames: usize) -> Result<VideoTiming, ImportError> {
    let corrupt = |reason: String| ImportError::corrupt(video.file(), reason);
    let shown = video.frame_count();
    if shown < frames {
        return Err(corrupt(format!(
            "expected {frames} frames, one per state, got {shown}"
        )));
    }
    let note = (shown > frames).then(|| {
        let more = shown - frames;
        format!("a video has {more} frames after the last state, which are ignored")
    });
    let period = video.time_s(1).unwrap_or(DEFAULT_PERIOD_S);
    if !(0.01..=10.0).contains(&period) {
        return Err(corrupt(format!(
            "expected 0.1 to 100 frames per second, got one after {period} s"
        )));
    }
    for frame in 0..frames {
        let (expected, got) = (frame as f64 * period, video.time_s(frame));
        // Tolerance of a thousandth of a frame: times are ticks of the video's clock.
        if got.is_none_or(|got| (got - expected).abs() > period / 1000.0) {
            return Err(corrupt(format!(
                "frame {frame}: expected it at {expected} s, got {got:?}"
            )));
        }
    }
    Ok(VideoTiming {
        period_s: period,
        note,
    })
}

#[cfg(test)]
mod tests;
