//! `NAME.mp4` (frames) with `NAME.npz` (actions, scaled for a model, and labels).

mod actions;
mod arrays;

use std::path::{Path, PathBuf};

use crate::{
    ActionMapping, ImportError,
    episode::{BRIDGE_PERIOD_NS, Episode, FoundEpisode, Trajectory, UnreadEpisode, bridge_cameras},
    mapping::VALUES,
    origin::origin,
    remedy::ValueSource,
    video::Video,
};
use actions::LabelledActions;

/// The episodes of these pairs of video and actions.
pub(crate) fn episodes(
    pairs: Vec<(PathBuf, PathBuf)>,
    jpeg_quality: u8,
) -> impl Iterator<Item = FoundEpisode> {
    pairs.into_iter().map(move |(video, arrays)| {
        let unread: Box<dyn UnreadEpisode> = Box::new(VideoPair {
            video,
            arrays,
            jpeg_quality,
        });
        Ok(unread)
    })
}

/// A video and its arrays, not yet read.
struct VideoPair {
    video: PathBuf,
    arrays: PathBuf,
    jpeg_quality: u8,
}

impl VideoPair {
    fn labelled_actions(&self) -> Result<LabelledActions, ImportError> {
        for (present, missing) in [(&self.video, &self.arrays), (&self.arrays, &self.video)] {
            if !missing.exists() {
                return Err(ImportError::Incomplete {
                    present: present.clone(),
                    missing: missing.clone(),
                });
            }
        }
        actions::read(&self.arrays)
    }
}

impl UnreadEpisode for VideoPair {
    fn origin(&self, src: &Path) -> String {
        origin(src, Some(&self.video), None)
    }

    fn recorded(&self, mapping: &ActionMapping) -> Result<Trajectory, ImportError> {
        let labelled = self.labelled_actions()?;
        Ok(recorded(labelled.actions, mapping))
    }

    fn read(&self, mapping: &ActionMapping) -> Result<Episode, ImportError> {
        let labelled = self.labelled_actions()?;
        let video = Video::open(&self.video)?;
        let frames = video.jpegs(0..video.frame_count(), self.jpeg_quality)?;
        Episode {
            source: self.video.clone(),
            cameras: bridge_cameras(vec![frames]),
            recorded: recorded(labelled.actions, mapping),
            instruction: labelled.instruction,
            success: labelled.success,
            notes: labelled.notes,
            ..Episode::default()
        }
        .check()
    }
}

fn recorded(mut actions: Vec<[f32; VALUES]>, mapping: &ActionMapping) -> Trajectory {
    // Exact: a fifth of a second.
    mapping.apply(&mut actions, &[], BRIDGE_PERIOD_NS as f64 / 1e9);
    Trajectory {
        period_ns: BRIDGE_PERIOD_NS,
        actions,
        states: Vec::new(),
        source: ValueSource {
            gripper: mapping.gripper,
            is_of_states: false,
        },
    }
}

#[cfg(test)]
pub(crate) mod tests;
