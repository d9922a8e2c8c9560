//! `NAME.mp4` (frames) with `NAME.npz` (actions, scaled for a model).

mod actions;

use std::path::PathBuf;

use crate::{
    ImportError,
    episode::{Episode, bridge_cameras},
    video::Video,
};

/// The episodes of these pairs of video and actions, each read when it is asked for.
pub(crate) fn episodes(
    pairs: Vec<(PathBuf, PathBuf)>,
    jpeg_quality: u8,
) -> impl Iterator<Item = Result<Episode, ImportError>> {
    pairs.into_iter().map(move |(video_file, actions_file)| {
        let actions = actions::read(&actions_file)?;
        let video = Video::open(&video_file)?;
        let frames = video.jpegs(0..video.frame_count(), jpeg_quality)?;
        Episode {
            source: video_file,
            cameras: bridge_cameras(vec![frames]),
            actions,
            ..Episode::default()
        }
        .check()
    })
}

#[cfg(test)]
pub(crate) mod tests;
