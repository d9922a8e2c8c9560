//! `NAME.mp4` (frames) with `NAME.npz` (actions, scaled for a model).

mod actions;
mod mp4;
mod video;

use std::path::PathBuf;

use crate::{ImportError, episode::Episode};

/// The episodes of these pairs of video and actions, each read when it is asked for.
pub(crate) fn episodes(
    pairs: Vec<(PathBuf, PathBuf)>,
    jpeg_quality: u8,
) -> impl Iterator<Item = Result<Episode, ImportError>> {
    pairs.into_iter().map(move |(video_file, actions_file)| {
        let actions = actions::read(&actions_file)?;
        let frames = video::read(&video_file, jpeg_quality)?;
        Episode {
            source: video_file,
            cameras: vec![frames],
            actions,
            states: Vec::new(),
            instruction: None,
        }
        .check()
    })
}

#[cfg(test)]
mod tests;
