//! The places of a data set's episodes, for both versions.

mod rows;
mod v21;
mod v30;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

pub(crate) use rows::Rows;

use crate::lerobot::{
    LeRobotError,
    info::{INFO, Info},
    path_template::fill,
};

/// An open data set: its metadata is read, its episodes are not.
#[derive(Debug)]
pub(crate) struct Dataset {
    pub root: PathBuf,
    pub info: Info,
    /// By number.
    pub tasks: BTreeMap<i64, String>,
    /// Sorted by number.
    pub episodes: Vec<EpisodeEntry>,
}

/// The places of an episode.
#[derive(Debug)]
pub(crate) struct EpisodeEntry {
    pub index: i64,
    /// Number of frames.
    pub length: u64,
    pub data: PathBuf,
    /// By feature.
    pub videos: BTreeMap<String, Clip>,
    /// Stamp of the first frame in ns, if our own export kept it.
    pub start_ns: Option<u64>,
}

/// A part of a video.
#[derive(Clone, Debug)]
pub(crate) struct Clip {
    pub file: PathBuf,
    /// Start of the episode in it, in s.
    pub from_s: f64,
}

impl Dataset {
    /// Reads `meta/` of a data set of version 2.x or 3.x.
    pub fn open(root: &Path) -> Result<Self, LeRobotError> {
        let info = Info::read(root)?;
        let version = info.codebase_version.as_str();
        let (tasks, mut episodes) = match version.trim_start_matches('v').split_once('.') {
            Some(("2", _)) => v21::read(root, &info)?,
            Some(("3", _)) => v30::read(root, &info)?,
            _ => {
                return Err(LeRobotError::corrupt(
                    &root.join(INFO),
                    format!("codebase_version: expected v2.x or v3.x, got {version:?}"),
                ));
            }
        };
        episodes.sort_by_key(|episode| episode.index);
        Ok(Self {
            root: root.to_owned(),
            info,
            tasks,
            episodes,
        })
    }
}

/// Fills a path template of `meta/info.json`.
fn fill_path(
    root: &Path,
    template: &str,
    texts: &[(&str, &str)],
    numbers: &[(&str, i64)],
) -> Result<PathBuf, LeRobotError> {
    let path = fill(template, texts, numbers);
    path.map(|path| root.join(path))
        .map_err(|reason| LeRobotError::corrupt(&root.join(INFO), reason))
}

/// The path template of videos, which a data set with videos needs.
fn video_path<'a>(root: &Path, info: &'a Info) -> Result<&'a str, LeRobotError> {
    info.video_path.as_deref().ok_or_else(|| {
        LeRobotError::corrupt(&root.join(INFO), "video_path: expected a path, got null")
    })
}
