//! `NAME.mp4` (frames) with `NAME.npz` (actions, scaled for a model).

mod actions;

use std::path::{Path, PathBuf};

use crate::{
    ImportError,
    episode::{Episode, Unread, bridge_cameras},
    video::Video,
};

/// The episodes of these pairs of video and actions.
pub(crate) fn episodes(
    pairs: Vec<(PathBuf, PathBuf)>,
    jpeg_quality: u8,
) -> impl Iterator<Item = Result<Unread, ImportError>> {
    pairs.into_iter().map(move |(video, actions)| {
        let unread: Unread = Box::new(move || episode(video, &actions, jpeg_quality));
        Ok(unread)
    })
}

fn episode(
    video_file: PathBuf,
    actions_file: &Path,
    jpeg_quality: u8,
) -> Result<Episode, ImportError> {
    let actions = actions::read(actions_file)?;
    let video = Video::open(&video_file)?;
    let frames = video.jpegs(0..video.frame_count(), jpeg_quality)?;
    Episode {
        source: video_file,
        cameras: bridge_cameras(vec![frames]),
        actions,
        ..Episode::default()
    }
    .check()
}

#[cfg(test)]
pub(crate) mod tests;
