//! Recordings as training wants them: episodes of frames that are decoded and resized once, in a memory-mapped file,
//! beside the action taken at each frame.
//!
//! [`Data::open`] takes bags and folders that `wm dataset` prepared, and gives what to train on and what to measure on.
//! Bags are read twice. The first reading keeps stamps and actions and cuts the recordings into episodes; the second one
//! decodes the frames that are in one, and writes each to its place in the file. So memory holds one picture a thread and
//! about 15 MB for an hour of actions at 100 Hz, however long a recording is.
//!
//! Prepared data are keyed by the contents of the bags, the options, the picture size and the fit: other contents make a
//! new folder in the cache.

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
mod options;
mod preparation;
mod recording;
mod search;
mod size;
mod source_sizes;
mod spans;
mod split;
mod statistics;
mod store;
#[cfg(any(test, feature = "testing"))]
pub mod testing;

use std::{collections::BTreeMap, sync::Arc};

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

/// One episode of a [`Dataset`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// The bag's name, and a number where the bag has several episodes.
    pub name: String,
    /// Index of its first frame in the dataset.
    pub first_frame: usize,
    /// How many frames it has.
    pub frame_count: usize,
    /// What the robot does from each frame to the next, in the units of the dataset's action space.
    pub actions: Vec<Vec<f32>>,
    /// The task in words (`/task/instruction`), if known.
    pub instruction: Option<String>,
    /// Whether the robot did it (`/task/success`), where that is known.
    pub success: Option<bool>,
    /// What the values of its masks mean (`/camera/mask/label_info`), where that is known.
    pub labels: BTreeMap<u8, String>,
}

/// Decoded episodes; see the module's documentation.
#[derive(Debug)]
pub struct Dataset {
    digest: String,
    framing: Framing,
    space: ActionSpace,
    layout: Layout,
    folders: Vec<Arc<Folder>>,
}

impl Dataset {
    /// The episodes that `is_in` chooses by the numbers of folder and episode, of at least one folder.
    fn of_folders(
        folders: Vec<data::Opened>,
        (options, fit): (&DataOptions, Fit),
        is_in: impl Fn(usize, usize) -> bool,
    ) -> Result<Self, DatasetError> {
        let Some(first) = folders.first() else {
            return Err(DatasetError::Nothing("    no path is given".to_owned()));
        };
        let manifest = first.folder.manifest();
        let (views, size) = (first.folder.views(), manifest.size);
        let own = manifest.action_space.clone();
        let asked = options.space()?;
        let mut hash = Sha256::new();
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
            if let Some(asked) = &asked {
                expect_same_space(asked, &b.action_space).map_err(prepared)?;
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
            for (index, episode) in folder.all_episodes().iter().enumerate() {
                if is_in(number, index) {
                    hash.update(index.to_le_bytes());
                    layout.push(number, episode);
                }
            }
        }
        Ok(Self {
            digest: fingerprint::hex(hash),
            framing: Framing {
                size: (size.height, size.width * views),
                views,
                fit,
            },
            space: asked.unwrap_or(own),
            layout,
            folders: folders.into_iter().map(|opened| opened.folder).collect(),
        })
    }

    /// Refuses a data set of another robot.
    fn expect_same(&self, other: &Self) -> Result<(), DatasetError> {
        let dir = other.folders.first().map(|folder| folder.dir().to_owned());
        let prepared = |what| DatasetError::Prepared {
            dir: dir.unwrap_or_default(),
            what,
        };
        expect_same_space(&self.space, &other.space).map_err(prepared)
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

    /// Height and width of the frames, all cameras together.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        self.framing.size
    }

    /// How the pictures in the bags became its frames.
    #[must_use]
    pub fn framing(&self) -> Framing {
        self.framing
    }

    /// The size of all pictures in the bags; `None` if there are several sizes or cameras, or it was not recorded.
    #[must_use]
    pub fn picture_size(&self) -> Option<PictureSize> {
        let mut sizes = self.folders.iter().map(|f| f.manifest().picture_size());
        let first = sizes.next()??;
        (self.views() == 1 && sizes.all(|size| size == Some(first))).then_some(first)
    }

    /// Number of cameras, whose pictures lie side by side in a frame.
    #[must_use]
    pub fn views(&self) -> usize {
        self.framing.views
    }

    /// Frames of all episodes together.
    #[must_use]
    pub fn frame_count(&self) -> usize {
        self.layout.frame_count()
    }

    /// The episodes, in the order of their frames.
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

    /// The mask of frame `index`: height x width bytes, 0 background, 1 gripper, 2 and above objects; `None` past the
    /// end, or where the bags have no masks.
    #[must_use]
    pub fn mask(&self, index: usize) -> Option<&[u8]> {
        let (folder, frame) = self.layout.locate(index)?;
        self.folders.get(folder)?.mask(frame)
    }

    /// Statistics of its episodes, and its action space with scales and clips fitted to them.
    ///
    /// # Errors
    /// When no scale fits a dimension's range.
    pub fn statistics(&self) -> Result<DataStatistics, DatasetError> {
        let statistics = DataStatistics::of_episodes(self.episodes().iter(), &self.space);
        statistics.map_err(|error| DatasetError::Option {
            option: "--action-space",
            what: error.to_string(),
        })
    }

    pub(crate) fn layout(&self) -> &Layout {
        &self.layout
    }

    /// What was left out when it was prepared.
    pub fn left_out(&self) -> impl Iterator<Item = &LeftOut> {
        let folders = self.folders.iter();
        folders.flat_map(|folder| &folder.manifest().left_out)
    }

    /// Where its frames are.
    pub(crate) fn folders(&self) -> &[Arc<Folder>] {
        &self.folders
    }
}

/// Whether actions are the same, and at the same rate, at which frames were prepared.
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
