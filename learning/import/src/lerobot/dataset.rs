//! Where a dataset keeps each episode, the same for both versions.

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

/// A dataset that has been opened: its metadata are read, its episodes not.
#[derive(Debug)]
pub(crate) struct Dataset {
    pub root: PathBuf,
    pub info: Info,
    /// By their numbers.
    pub tasks: BTreeMap<i64, String>,
    /// In the order of their numbers.
    pub episodes: Vec<Entry>,
}

/// Where an episode is.
#[derive(Debug)]
pub(crate) struct Entry {
    pub index: i64,
    /// Frames.
    pub length: u64,
    pub data: PathBuf,
    /// By feature.
    pub videos: BTreeMap<String, Clip>,
    /// Stamp of the first frame in ns, where our own export kept it.
    pub start_ns: Option<u64>,
}

/// A part of a video.
#[derive(Clone, Debug)]
pub(crate) struct Clip {
    pub file: PathBuf,
    /// Where the episode begins in it, in s.
    pub from_s: f64,
}

impl Dataset {
    /// Reads `meta/` of a dataset of version 2.x or 3.x.
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

/// A path of `meta/info.json`, filled in.
fn path(
    root: &Path,
    template: &str,
    texts: &[(&str, &str)],
    numbers: &[(&str, i64)],
) -> Result<PathBuf, LeRobotError> {
    let path = fill(template, texts, numbers);
    path.map(|path| root.join(path))
        .map_err(|reason| LeRobotError::corrupt(&root.join(INFO), reason))
}

/// The template of the videos' paths; a dataset that has videos needs it.
fn video_path<'a>(root: &Path, info: &'a Info) -> Result<&'a str, LeRobotError> {
    info.video_path.as_deref().ok_or_else(|| {
        LeRobotError::corrupt(&root.join(INFO), "video_path: expected a path, got null")
    })
}
