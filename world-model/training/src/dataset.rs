//! Episodes of bags as training wants them: every frame decoded and resized once, in one memory-mapped file, beside the
//! action taken at each frame.
//!
//! The cache is keyed by a digest of the bags' names and contents and of the picture size; a changed bag makes a new
//! one. Memory stays at one episode a thread, however many there are.

mod cache;
mod episode;

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use thiserror::Error;
use wm_bag::BagReader;
use wm_motion::actions::ActionSpace;

use cache::Cache;

/// Why a set of bags cannot be trained on.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// No bag under the folder.
    #[error("{0}: expected bags of episodes (folders with metadata.yaml), found none")]
    Empty(PathBuf),
    /// A bag cannot be read.
    #[error("{bag}: {source}")]
    Bag {
        /// The bag.
        bag: PathBuf,
        /// Why.
        source: Box<wm_bag::BagError>,
    },
    /// A bag lacks what training needs, or holds something it cannot use.
    #[error("{bag}: {what}")]
    Episode {
        /// The bag.
        bag: PathBuf,
        /// What was expected and what came.
        what: String,
    },
    /// The cache cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// One episode of a [`Dataset`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// The bag's folder name.
    pub name: String,
    /// Index of its first frame in the dataset.
    pub first_frame: usize,
    /// How many frames it has.
    pub frame_count: usize,
    /// What the robot does from each frame to the next, in the units of the dataset's action space.
    pub actions: Vec<Vec<f32>>,
}

/// Decoded episodes; see the module's documentation.
#[derive(Debug)]
pub struct Dataset {
    digest: String,
    size: (usize, usize),
    space: ActionSpace,
    episodes: Vec<Episode>,
    frames: memmap2::Mmap,
    masks: Option<memmap2::Mmap>,
}

impl Dataset {
    /// The episodes of all bags right under `bags_root` (or of `bags_root` itself, where it is a bag), with frames of
    /// `size` (height, width); decoded now, or taken from `cache_dir` where an earlier call has left them.
    ///
    /// # Errors
    /// When there is no bag, or one lacks camera or actions, or cannot be read: the error names it.
    pub fn open(
        bags_root: &Path,
        cache_dir: &Path,
        size: (usize, usize),
    ) -> Result<Self, DatasetError> {
        let bags = find_bags(bags_root)?;
        let space = common_space(&bags)?;
        let digest = digest(&bags, size)?;
        let cache = Cache::at(cache_dir, &digest);
        if !cache.is_complete() {
            decode(&bags, size, &space, &cache)?;
        }
        let (episodes, frames, masks) = cache.open()?;
        Ok(Self {
            digest,
            size,
            space,
            episodes,
            frames,
            masks,
        })
    }

    /// Hex SHA-256 of what the dataset was made from.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// What its actions are.
    #[must_use]
    pub fn action_space(&self) -> &ActionSpace {
        &self.space
    }

    /// Height and width of the frames.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Frames of all episodes together.
    #[must_use]
    pub fn frame_count(&self) -> usize {
        self.episodes
            .iter()
            .map(|episode| episode.frame_count)
            .sum()
    }

    /// The episodes, in the order of their frames.
    #[must_use]
    pub fn episodes(&self) -> &[Episode] {
        &self.episodes
    }

    /// Frame `index`: height x width x 3 bytes, RGB; `None` past the end.
    #[must_use]
    pub fn frame(&self, index: usize) -> Option<&[u8]> {
        let bytes = self.size.0 * self.size.1 * 3;
        self.frames.get(index * bytes..(index + 1) * bytes)
    }

    /// The mask of frame `index`: height x width bytes, 0 background, 1 gripper, 2 and above objects; `None` past the
    /// end, or where the bags have no masks.
    #[must_use]
    pub fn mask(&self, index: usize) -> Option<&[u8]> {
        let bytes = self.size.0 * self.size.1;
        self.masks.as_ref()?.get(index * bytes..(index + 1) * bytes)
    }
}

fn find_bags(root: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    if root.join("metadata.yaml").is_file() {
        return Ok(vec![root.to_owned()]);
    }
    let io = |source| DatasetError::Io {
        path: root.to_owned(),
        source,
    };
    let (mut bags, mut others) = (Vec::new(), Vec::new());
    for entry in std::fs::read_dir(root).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if path.join("metadata.yaml").is_file() {
            bags.push(path);
        } else if path.is_dir() {
            others.push(path.display().to_string());
        }
    }
    if !others.is_empty() {
        others.sort();
        tracing::warn!(
            "{} folder(s) skipped, because they have no metadata.yaml (`wm bag recover` repairs a truncated \
             recording): {}",
            others.len(),
            others.join(", ")
        );
    }
    if bags.is_empty() {
        return Err(DatasetError::Empty(root.to_owned()));
    }
    bags.sort();
    Ok(bags)
}

fn open_bag(bag: &Path) -> Result<BagReader, DatasetError> {
    BagReader::open(bag).map_err(|source| DatasetError::Bag {
        bag: bag.to_owned(),
        source: Box::new(source),
    })
}

fn digest(bags: &[PathBuf], size: (usize, usize)) -> Result<String, DatasetError> {
    let mut hash = Sha256::new();
    // The number counts up where frames or actions are made of the same bags in another way.
    hash.update(format!("2 {}x{}\n", size.0, size.1));
    for bag in bags {
        hash.update(bag.file_name().unwrap_or_default().as_encoded_bytes());
        let io = |path: &Path| {
            let path = path.to_owned();
            move |source| DatasetError::Io { path, source }
        };
        let mut files = Vec::new();
        for entry in std::fs::read_dir(bag).map_err(io(bag))? {
            files.push(entry.map_err(io(bag))?.path());
        }
        files.sort();
        for path in files.iter().filter(|path| path.is_file()) {
            let mut contents = Sha256::new();
            let mut file = std::fs::File::open(path).map_err(io(path))?;
            std::io::copy(&mut file, &mut contents).map_err(io(path))?;
            hash.update(path.file_name().unwrap_or_default().as_encoded_bytes());
            hash.update(contents.finalize());
        }
    }
    Ok(hash
        .finalize()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect())
}

/// The action space that all bags share.
fn common_space(bags: &[PathBuf]) -> Result<ActionSpace, DatasetError> {
    let mut common: Option<(&PathBuf, ActionSpace)> = None;
    for bag in bags {
        let space = episode::action_space(&open_bag(bag)?, bag)?;
        match &common {
            None => common = Some((bag, space)),
            Some((first, expected)) => {
                let (own, others) = (first.display().to_string(), bag.display().to_string());
                expected
                    .expect_same(&space, &own, &others)
                    .map_err(|error| DatasetError::Episode {
                        bag: bag.clone(),
                        what: error.to_string(),
                    })?;
            }
        }
    }
    Ok(common.map_or_else(ActionSpace::bridge, |(_, space)| space))
}

fn decode(
    bags: &[PathBuf],
    size: (usize, usize),
    space: &ActionSpace,
    cache: &Cache,
) -> Result<(), DatasetError> {
    let style = ProgressStyle::with_template("decoding {bar:40} {pos}/{len} bags, {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let progress = ProgressBar::new(bags.len() as u64).with_style(style);
    let mut writer = cache.create()?;
    // A few bags at a time: parallel, in order, and bounded in memory.
    for group in bags.chunks(4 * rayon::current_num_threads()) {
        let decoded = group
            .par_iter()
            .map(|bag| episode::decode(&open_bag(bag)?, bag, size, space))
            .collect::<Result<Vec<_>, _>>()?;
        for (bag, episode) in group.iter().zip(decoded) {
            writer.push(bag, episode)?;
            progress.inc(1);
        }
    }
    progress.finish_and_clear();
    writer.finish()
}

#[cfg(test)]
mod tests;
