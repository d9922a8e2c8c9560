use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use wm_model::Fit;
use wm_motion::actions::ActionSpace;

use super::{Settings, Size, SourceSize, SplitRule, fingerprint::hex};

/// Increases when older code cannot read new folders, or the same bags give other frames or actions.
pub(super) const VERSION: u32 = 4;

/// The description of a prepared folder: `dataset.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of the format.
    pub version: u32,
    /// Hex SHA-256 of its inputs: contents of the bags, settings, picture size and fit.
    pub digest: String,
    /// Size of one camera's picture. Frames have this height, and the width of all cameras together.
    pub size: Size,
    /// How pictures of another aspect fit this size.
    #[serde(default, skip_serializing_if = "Fit::is_stretch")]
    pub fit: Fit,
    /// Sizes of the pictures in the bags; empty if prepared by an earlier version.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub source_sizes: Vec<SourceSize>,
    /// Topics of the cameras without transport, left to right.
    pub cameras: Vec<String>,
    /// Whether each frame has a mask.
    pub has_masks: bool,
    /// Settings of the preparation.
    pub settings: Settings,
    /// Rule of the validation split.
    pub split: SplitRule,
    /// Space of the actions.
    pub action_space: ActionSpace,
    /// The bags of the episodes.
    pub sources: Vec<Source>,
    /// Episodes by frame.
    pub episodes: Vec<ManifestEpisode>,
    /// Excluded data, with reasons.
    pub left_out: Vec<LeftOut>,
}

impl Manifest {
    /// Hex SHA-256 of bags and settings, without the size and the fit of the frames.
    pub(super) fn recordings_digest(&self) -> String {
        let mut hash = Sha256::new();
        // Settings are numbers, lists and texts: JSON cannot fail.
        hash.update(serde_json::to_vec(&self.settings).unwrap_or_default());
        for source in &self.sources {
            hash.update(&source.digest);
        }
        hex(hash)
    }
}

/// A bag.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// Path, as given or found.
    pub bag: PathBuf,
    /// Hex SHA-256 of its files.
    pub digest: String,
    /// Whether it was given for validation.
    pub held_out: bool,
}

/// Purpose of an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// For fitting.
    Training,
    /// For measuring.
    Validation,
}

/// An episode of a prepared folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ManifestEpisode {
    /// The bag's name, with a number if the bag has several episodes.
    pub name: String,
    /// Index of its bag among the sources.
    pub source: usize,
    /// Stamp of its first frame \[ns\].
    pub begin_ns: i64,
    /// Stamp of the first frame of the episode that this one continues after a gap \[ns\]: both are on one side of the
    /// split.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub continues_ns: Option<i64>,
    /// Stamp of its last frame \[ns\].
    pub end_ns: i64,
    /// Number of frames.
    pub frames: usize,
    /// Purpose.
    pub split: Split,
    /// The task in words.
    pub instruction: Option<String>,
    /// Whether the task succeeded.
    pub success: Option<bool>,
    /// Meaning of the mask values.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<u8, String>,
}

/// Data excluded from all episodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeftOut {
    /// The folder or bag.
    pub path: PathBuf,
    /// Stamps of the first and the last frame \[ns\], for a part of a bag.
    pub span_ns: Option<(i64, i64)>,
    /// Number of excluded items; `None` for a whole folder or bag.
    pub count: Option<(u64, Thing)>,
    /// Reason.
    pub reason: String,
}

/// Kind of excluded items.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Thing {
    /// Pictures of the first camera.
    Frame,
    /// Pictures of any topic.
    Picture,
    /// Messages of the topic of the actions.
    Action,
    /// Messages of any topic.
    Message,
}

impl Thing {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Frame => "frame",
            Self::Picture => "picture",
            Self::Action => "action",
            Self::Message => "message",
        }
    }
}

impl LeftOut {
    pub(super) fn path(path: &Path, reason: &str) -> Self {
        Self {
            path: path.to_owned(),
            span_ns: None,
            count: None,
            reason: reason.to_owned(),
        }
    }
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let path = self.path.display().to_string();
        // Errors of the bag reader include the path.
        if !self.reason.starts_with(&path) {
            write!(f, "{path}: ")?;
        }
        if let Some((count, thing)) = self.count {
            let count = usize::try_from(count).unwrap_or(usize::MAX);
            write!(f, "{}", counted(count, thing.name()))?;
            if let Some((begin, end)) = self.span_ns {
                write!(f, " from {begin} to {end} ns")?;
            }
            write!(f, ": ")?;
        }
        write!(f, "{}", self.reason)
    }
}

/// A summary in a few lines.
impl fmt::Display for Manifest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rate = self.action_space.rate();
        writeln!(f, "{}", self.action_space)?;
        writeln!(
            f,
            "cameras: {} ({} each, fit {}{}), {rate} Hz",
            self.cameras.join(", "),
            self.size,
            self.fit,
            if self.has_masks { ", with masks" } else { "" }
        )?;
        for source in &self.source_sizes {
            let SourceSize {
                camera,
                size,
                pictures,
            } = source;
            let count = usize::try_from(*pictures).unwrap_or(usize::MAX);
            writeln!(f, "{camera}: {} of {size}", counted(count, "picture"))?;
        }
        for (split, name) in [
            (Split::Training, "training"),
            (Split::Validation, "validation"),
        ] {
            let mut count = 0;
            let mut frames = 0;
            let (mut succeeded, mut known) = (0, 0);
            let mut instructions = std::collections::BTreeSet::new();
            for episode in self.episodes.iter().filter(|e| e.split == split) {
                count += 1;
                frames += episode.frames;
                instructions.extend(&episode.instruction);
                if let Some(success) = episode.success {
                    known += 1;
                    succeeded += usize::from(success);
                }
            }
            let minutes = frames as f64 / rate / 60.0;
            write!(
                f,
                "{name}: {}, {frames} frames ({minutes:.1} min)",
                counted(count, "episode")
            )?;
            if !instructions.is_empty() {
                write!(f, ", {}", counted(instructions.len(), "instruction"))?;
            }
            if known > 0 {
                write!(f, ", {succeeded} of {known} succeeded")?;
            }
            writeln!(f)?;
        }
        let bags = counted(self.sources.len(), "bag");
        match self.left_out.len() {
            0 => write!(f, "{bags}; nothing was left out"),
            count => write!(
                f,
                "{bags}; left out, with the reasons: {}",
                counted(count, "entry")
            ),
        }
    }
}

/// A count with its noun.
pub(super) fn counted(count: usize, thing: &str) -> String {
    match (count, thing.strip_suffix('y')) {
        (1, _) => format!("1 {thing}"),
        (_, Some(stem)) => format!("{count} {stem}ies"),
        _ => format!("{count} {thing}s"),
    }
}
