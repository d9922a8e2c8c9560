//! Imports robot episodes as bags: Bridge V2 in its two common layouts, DROID, and LeRobot (feature `lerobot`).
//!
//! | layout | found by | cameras | actions | more |
//! |---|---|---|---|---|
//! | Bridge video | `NAME.mp4` (h264) with `NAME.npz` | one | scaled for a model, undone here | instruction, success |
//! | Bridge RLDS | a TFRecord (`*.tfrecord*`) of `tf.train.Example` | several | m, rad, gripper 0..1 | state, instruction, success |
//! | DROID | `annotation/SPLIT/NAME.json` with `videos/` | three | from state to state | state, joints, instruction, success |
//! | DROID RLDS | a TFRecord with `cartesian_position` | three | from state to state | state, joints, instruction, success |
//!
//! Each episode becomes a bag, `episode_000000` and so on: Bridge V2 at its 5 Hz, DROID's RLDS at 15 Hz, DROID's videos at
//! their rate.
//!
//! | topic | type |
//! |---|---|
//! | `/camera/image_raw/compressed`, `/camera_1/...` (Bridge); `/exterior_1/...`, `/exterior_2/...`, `/wrist/...` (DROID) | `sensor_msgs/msg/CompressedImage` (JPEG) |
//! | `/wm/action` | `wm_msgs/msg/Action`: dx dy dz \[m\], droll dpitch dyaw \[rad\], gripper \[0 closed .. 1 open\] |
//! | `/arm/end_effector_pose`, `/arm/gripper` | `geometry_msgs/msg/PoseStamped`, `std_msgs/msg/Float32`, if the data have states |
//! | `/joint_states` | `sensor_msgs/msg/JointState`, if the data have joints |
//! | `/task/instruction` | `std_msgs/msg/String`, latched, if known |
//! | `/task/success` | `std_msgs/msg/Bool`, latched, if known |
//!
//! ```no_run
//! use wm_import::{ImportOptions, import_bridge};
//!
//! let report = import_bridge("bridge_v2".as_ref(), "bags".as_ref(), &ImportOptions::default())?;
//! println!("{} episodes, {} skipped", report.bags.len(), report.skipped.len());
//! # Ok::<(), wm_import::ImportError>(())
//! ```
//!
//! The bag's note [`wm_bag::ORIGIN`] has the source.
//!
//! An episode is read completely before its bag is written, and bags appear only when they are complete. Episodes that
//! cannot be read, or whose actions are impossible for an arm, are skipped and named ([`ImportReport::skipped`]).
//!
//! LeRobot data sets have the module `lerobot`. Its feature is optional, since parquet and video codecs are large.

mod droid;
mod episode;
mod error;
mod imported;
mod jpeg;
#[cfg(feature = "lerobot")]
pub mod lerobot;
mod mapping;
mod mp4_npz;
mod origin;
mod remedy;
mod rlds;
mod run;
mod source;
#[cfg(test)]
mod testing;
pub mod video;

use std::path::Path;

use episode::FoundEpisode;
pub use error::ImportError;
pub use imported::{ImportReport, Notes};
pub use mapping::{ActionForm, ActionMapping, GripperRange};
use source::Source;
pub use wm_bag::Shard;

/// Options of an import.
#[derive(Clone, Debug)]
pub struct ImportOptions {
    /// Limit of episodes; `None` imports all.
    pub episodes: Option<usize>,
    /// The shard to import, if several machines share an import. The bags keep their numbers.
    pub shard: Shard,
    /// Whether whole bags of the same episodes, of an earlier run, are kept instead of an error.
    pub resume: bool,
    /// JPEG quality of frames that are not JPEG yet, 1 to 100.
    pub jpeg_quality: u8,
    /// Stamp of the first frame of each episode, in ns since the epoch; the data have no times.
    pub start_ns: u64,
    /// Mapping of the action values to Bridge V2's.
    pub actions: ActionMapping,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            episodes: None,
            shard: Shard::WHOLE,
            resume: false,
            jpeg_quality: 95,
            // A fixed time makes imports reproducible; 0 means "no time" in ROS.
            start_ns: 1_700_000_000_000_000_000,
            actions: ActionMapping::default(),
        }
    }
}

/// Imports Bridge V2 episodes as bags `OUT/episode_NNNNNN`. Detects the layout.
///
/// `src` is a folder, an `.mp4` or `.npz`, or a TFRecord. A shard may have no episodes.
///
/// # Errors
/// `src` has neither layout, its actions contradict `options.actions`, no episode can be imported (the error of the first),
/// or a bag exists.
pub fn import_bridge(
    src: &Path,
    out: &Path,
    options: &ImportOptions,
) -> Result<ImportReport, ImportError> {
    let quality = options.jpeg_quality;
    let episodes = || -> Result<Box<dyn Iterator<Item = FoundEpisode>>, ImportError> {
        Ok(match Source::find(src)? {
            Source::Mp4Npz(pairs) => Box::new(mp4_npz::episodes(pairs, quality)),
            Source::Rlds(shards) => Box::new(rlds::episodes(shards, quality)),
        })
    };
    run::import(episodes, src, out, options)
}

/// Imports DROID episodes as bags `OUT/episode_NNNNNN`, in the order of folders, splits and numbers.
///
/// `src` has `annotation/` and `videos/`, or subfolders with these, or it is or has TFRecords.
///
/// # Errors
/// `src` has no such layout, no episode can be imported (the error of the first), or a bag exists.
pub fn import_droid(
    src: &Path,
    out: &Path,
    options: &ImportOptions,
) -> Result<ImportReport, ImportError> {
    let quality = options.jpeg_quality;
    let episodes = || -> Result<Box<dyn Iterator<Item = FoundEpisode>>, ImportError> {
        Ok(match Source::find(src) {
            Ok(Source::Rlds(shards)) => Box::new(rlds::episodes(shards, quality)),
            _ => Box::new(droid::episodes(src, quality)?),
        })
    };
    run::import(episodes, src, out, options)
}
