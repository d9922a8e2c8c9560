//! Recordings prepared for training: episodes of frames, decoded and resized once into a memory-mapped file, with the
//! action at each frame.
//!
//! [`Data::open`] takes bags and folders prepared by `wm dataset`, and returns training and validation data. Bags are
//! read twice. The first pass keeps stamps and actions and cuts episodes; the second decodes the frames of episodes
//! into the file. Memory holds one picture per thread and about 15 MB per hour of actions at 100 Hz.
//!
//! The key of prepared data is the contents of the bags, the options, the picture size and the fit.

mod action_log;
mod arguments;
mod camera_message;
mod cameras;
mod clips;
mod cutting;
mod data;
mod error;
mod fingerprint;
mod frame_values;
mod held_out;
mod latents;
mod layout;
mod manifest;
mod mask;
mod options;
mod preparation;
mod recording;
mod scales;
mod search;
mod size;
mod source_sizes;
mod spans;
mod split;
mod statistics;
mod store;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
mod unusable_bag;

use std::{collections::BTreeMap, path::Path, sync::Arc};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use wm_model::{Fit, Framing, PictureSize};
use wm_motion::actions::ActionSpace;

pub use arguments::DatasetArgs;
pub use clips::{Clip, ClipSource};
pub use data::Data;
pub use error::DatasetError;
pub(crate) use fingerprint::short;
pub use frame_values::FrameValues;
pub use held_out::HeldOutArgs;
pub use latents::Latents;
pub(crate) use layout::Layout;
pub use manifest::{LeftOut, Manifest, ManifestEpisode, Source, Split, Thing};
pub use options::{Cut, DataOptions, Settings, SplitRule, StampSource};
pub use size::Size;
pub use source_sizes::SourceSize;
pub use statistics::{DataStatistics, LatentStatistics, Statistics, SuccessCounts};
pub(crate) use store::Folder;

/// Mask values from this one on are objects; 1 is the gripper, 0 the background.
pub const FIRST_OBJECT: u8 = 2;

/// One episode of a [`Dataset`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// The bag's name, with a number if the bag has several episodes.
    pub name: String,
    /// Index of its first frame in the dataset.
    pub first_frame: usize,
    /// Number of frames.
    pub frame_count: usize,
    /// Motion from each frame to the next, in the units of the action space.
    pub actions: Vec<Vec<f32>>,
    /// The task in words (`/task/instruction`), if known.
    pub instruction: Option<String>,
    /// Whether the task succeeded (`/task/success`), if known.
    pub success: Option<bool>,
    /// Meaning of the mask values (`/camera/mask/label_info`), if known.
    pub labels: BTreeMap<u8, String>,
}

/// DecodedFrames episodes.
#[derive(Debug)]
pub struct Dataset {
    digest: String,
    recordings_digest: String,
    framing: Framing,
    space: ActionSpace,
    layout: Layout,
    folders: Vec<Arc<Folder>>,
}

impl Dataset {
    /// The episodes selected by `is_in(folder, episode)`, from at least one folder.
    fn of_folders(
        folders: Vec<data::OpenFolder>,
        (options, fit): (&DataOptions, Fit),
        is_in: impl Fn(usize, usize) -> bool,
    ) -> Result<Self, DatasetError> {
        let Some(first) = folders.first() else {
            return Err(DatasetError::Nothing("    no path is given".to_owned()));
        };
        let manifest = first.folder.manifest();
        let (views, size) = (first.folder.views(), manifest.size);
        let own = manifest.action_space.clone();
        let requested = options.space()?;
        let (mut hash, mut of_recordings) = (Sha256::new(), Sha256::new());
        let mut layout = Layout::default();
        for (number, opened) in folders.iter().enumerate() {
            let folder = &opened.folder;
            let (a, b) = (&first.folder, folder);
            let prepared = |what: String| DatasetError::Prepared {
                dir: folder.dir().to_owned(),
                what,
            };
            let (a, b) = (a.manifest(), b.manifest());
            expect_same_space(&own, &b.action_space).map_err(prepared)?;
            if let Some(requested) = &requested {
                expect_same_space(requested, &b.action_space).map_err(prepared)?;
            }
            if a.cameras != b.cameras {
                return Err(prepared(format!(
                    "cameras differ: it has {}, but {} has {}",
                    b.cameras.join(", "),
                    first.folder.dir().display(),
                    a.cameras.join(", ")
                )));
            }
            hash.update(&b.digest);
            of_recordings.update(b.recordings_digest());
            for (index, episode) in folder.all_episodes().iter().enumerate() {
                if is_in(number, index) {
                    hash.update(index.to_le_bytes());
                    of_recordings.update(index.to_le_bytes());
                    layout.push(number, episode);
                }
            }
        }
        Ok(Self {
            digest: fingerprint::hex(hash),
            recordings_digest: fingerprint::hex(of_recordings),
            framing: Framing {
                size: (size.height, size.width * views),
                views,
                fit,
            },
            space: requested.unwrap_or(own),
            layout,
            folders: folders.into_iter().map(|opened| opened.folder).collect(),
        })
    }

    /// Rejects a data set of another robot.
    fn expect_same(&self, other: &Self) -> Result<(), DatasetError> {
        let dir = other.folders.first().map(|folder| folder.dir().to_owned());
        let prepared = |what| DatasetError::Prepared {
            dir: dir.unwrap_or_default(),
            what,
        };
        expect_same_space(&self.space, &other.space).map_err(prepared)
    }

    /// Hex SHA-256 of its inputs.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Hex SHA-256 of its episodes in the bags: the same for every size and fit of the frames, so that models of different
    /// encoders compare.
    #[must_use]
    pub fn recordings_digest(&self) -> &str {
        &self.recordings_digest
    }

    /// Space of its actions.
    #[must_use]
    pub fn action_space(&self) -> &ActionSpace {
        &self.space
    }

    /// Height and width of the frames, all cameras together.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        self.framing.size
    }

    /// How pictures became frames.
    #[must_use]
    pub fn framing(&self) -> Framing {
        self.framing
    }

    /// Size of all pictures in the bags; `None` if it varies, for several cameras, or if it was not recorded.
    #[must_use]
    pub fn picture_size(&self) -> Option<PictureSize> {
        let mut sizes = self.folders.iter().map(|f| f.manifest().picture_size());
        let first = sizes.next()??;
        (self.views() == 1 && sizes.all(|size| size == Some(first))).then_some(first)
    }

    /// Number of cameras, side by side in a frame.
    #[must_use]
    pub fn views(&self) -> usize {
        self.framing.views
    }

    /// Frames of all episodes.
    #[must_use]
    pub fn frame_count(&self) -> usize {
        self.layout.frame_count()
    }

    /// Episodes by frame.
    #[must_use]
    pub fn episodes(&self) -> &[Episode] {
        self.layout.episodes()
    }

    /// Frame `index`: height x width x 3 bytes, RGB; `None` past the end.
    #[must_use]
    pub fn frame(&self, index: usize) -> Option<&[u8]> {
        let (folder, frame) = self.layout.locate(index)?;
        self.folders.get(folder)?.frame(frame)
    }

    /// Mask of frame `index`: height x width bytes, 0 background, 1 gripper, [`FIRST_OBJECT`] and above objects; `None` past the end,
    /// or without masks.
    #[must_use]
    pub fn mask(&self, index: usize) -> Option<&[u8]> {
        let (folder, frame) = self.layout.locate(index)?;
        self.folders.get(folder)?.mask(frame)
    }

    /// Statistics of its episodes, and its action space with fitted scales and clips.
    ///
    /// # Errors
    /// If no scale fits the range of a dimension.
    pub fn statistics(&self) -> Result<DataStatistics, DatasetError> {
        let statistics = DataStatistics::of_episodes(self.episodes().iter(), &self.space);
        statistics.map_err(DatasetError::of_scales)
    }

    /// Names the dimensions whose scales do not suit the actions, with the option that uses fitted ones; `None` if all do.
    ///
    /// # Errors
    /// Those of [`Self::statistics`].
    pub fn scale_remark(&self) -> Result<Option<String>, DatasetError> {
        let dir = self
            .folders
            .first()
            .map_or(Path::new(""), |folder| folder.dir());
        let file = dir.join(store::ACTION_SPACE);
        scales::remark(&self.space, self.episodes(), &file).map_err(DatasetError::of_scales)
    }

    pub(crate) fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Whether this entry of a cache's folder, by its name, has frames or latents of this data set.
    #[must_use]
    pub fn is_cached_as(&self, name: &str) -> bool {
        let mut folders = self.folders.iter();
        folders.any(|folder| name.contains(&short(&folder.manifest().digest)))
    }

    /// Data excluded during preparation.
    pub fn left_out(&self) -> impl Iterator<Item = &LeftOut> {
        let folders = self.folders.iter();
        folders.flat_map(|folder| &folder.manifest().left_out)
    }

    /// The folders of its frames.
    pub(crate) fn folders(&self) -> &[Arc<Folder>] {
        &self.folders
    }
}

/// Checks that actions are the same, at the same rate.
fn expect_same_space(own: &ActionSpace, other: &ActionSpace) -> Result<(), String> {
    let same = own.expect_same(other, "the data set", "this part of it");
    same.map_err(|error| error.to_string())?;
    if own.rate() == other.rate() {
        return Ok(());
    }
    Err(format!(
        "rates differ: the data set has {} Hz, but this part of it {} Hz",
        own.rate(),
        other.rate()
    ))
}

#[cfg(test)]
mod tests;
