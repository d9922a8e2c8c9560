//! Recorded robot episodes as bags: Bridge V2 in the two layouts in which it is passed around, and DROID.
//!
//! | layout | found by | cameras | actions | more |
//! |---|---|---|---|---|
//! | Bridge video | `NAME.mp4` (h264) beside `NAME.npz` | one | scaled for a model, undone here | instruction, success |
//! | Bridge RLDS | a TFRecord (`*.tfrecord*`) of `tf.train.Example` | several | m, rad, gripper 0..1 | state, instruction, success |
//! | DROID | `annotation/SPLIT/NAME.json` beside `videos/` | three | from state to state | state, joints, instruction, success |
//! | DROID RLDS | a TFRecord with `cartesian_position` | three | from state to state | state, joints, instruction, success |
//!
//! Each episode becomes one bag, `episode_000000` and on; Bridge V2 at the 5 Hz at which it was recorded, DROID's RLDS at
//! 15 Hz, its videos at their rate:
//!
//! | topic | type |
//! |---|---|
//! | `/camera/image_raw/compressed`, `/camera_1/...` (Bridge); `/exterior_1/...`, `/exterior_2/...`, `/wrist/...` (DROID) | `sensor_msgs/msg/CompressedImage` (JPEG) |
//! | `/wm/action` | `wm_msgs/msg/Action`: dx dy dz \[m\], droll dpitch dyaw \[rad\], gripper \[0 closed .. 1 open\] |
//! | `/arm/end_effector_pose`, `/arm/gripper` | `geometry_msgs/msg/PoseStamped`, `std_msgs/msg/Float32`, where there is state |
//! | `/joint_states` | `sensor_msgs/msg/JointState`, where there are joints |
//! | `/task/instruction` | `std_msgs/msg/String`, latched, where there is one |
//! | `/task/success` | `std_msgs/msg/Bool`, latched, where it is known |
//!
//! ```no_run
//! use wm_import::{ImportOptions, import_bridge};
//!
//! let imported = import_bridge("bridge_v2".as_ref(), "bags".as_ref(), &ImportOptions::default())?;
//! println!("{} episodes, {} left out", imported.bags.len(), imported.skipped.len());
//! # Ok::<(), wm_import::ImportError>(())
//! ```
//!
//! The bag's metadata note where it came from ([`wm_bag::ORIGIN`], made by [`origin()`]).
//!
//! An episode is read whole before its bag is begun, and a bag appears when it is whole. An episode that cannot be read, or
//! whose actions no arm makes, is left out by name ([`Imported::skipped`]); the others are imported.
//!
//! LeRobot data sets have a module of their own, `lerobot`, behind the feature `lerobot`: parquet and the video codecs
//! make it heavy.

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

use episode::Found;
pub use error::ImportError;
pub use imported::{Imported, Notes, write_whole};
pub use jpeg::jpeg;
pub use mapping::{ActionForm, ActionMapping, GripperRange};
pub use origin::origin;
pub use remedy::ValueSource;
use source::Source;
pub use wm_bag::Shard;

/// How episodes are imported.
#[derive(Clone, Debug)]
pub struct ImportOptions {
    /// Import at most this many episodes; none imports all.
    pub episodes: Option<usize>,
    /// Import only the episodes of this shard: several machines share an import. The bags keep their numbers.
    pub shard: Shard,
    /// JPEG quality of frames that are not JPEG already, 1 to 100.
    pub jpeg_quality: u8,
    /// Stamp of the first frame of each episode, in ns since the epoch; the data carry no time of their own.
    pub start_ns: u64,
    /// How the action values become Bridge V2's.
    pub actions: ActionMapping,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            episodes: None,
            shard: Shard::WHOLE,
            jpeg_quality: 95,
            // Any fixed time serves, so that an import is reproducible; not 0, which ROS reads as "no time".
            start_ns: 1_700_000_000_000_000_000,
            actions: ActionMapping::default(),
        }
    }
}

/// Imports Bridge V2 episodes: each becomes a bag `OUT/episode_NNNNNN`. The layout is found by what `src` holds.
///
/// `src` may be a directory, one `.mp4` or `.npz`, or one TFRecord. Gives the bags, in order, and the episodes that cannot
/// be imported; a shard may have none.
///
/// # Errors
/// `src` holds neither layout; its actions are not what `options.actions` says; no episode can be imported (the error is
/// that of the first); or a bag already exists there.
pub fn import_bridge(
    src: &Path,
    out: &Path,
    options: &ImportOptions,
) -> Result<Imported, ImportError> {
    let quality = options.jpeg_quality;
    let episodes = || -> Result<Box<dyn Iterator<Item = Found>>, ImportError> {
        Ok(match Source::find(src)? {
            Source::Mp4Npz(pairs) => Box::new(mp4_npz::episodes(pairs, quality)),
            Source::Rlds(shards) => Box::new(rlds::episodes(shards, quality)),
        })
    };
    run::import(episodes, src, out, options)
}

/// Imports DROID episodes: each becomes a bag `OUT/episode_NNNNNN`, in the order of folders, splits and numbers.
///
/// `src` has `annotation/` and `videos/` in it, or folders that have, or it is a TFRecord, or has TFRecords in it.
///
/// # Errors
/// `src` holds no such layout; no episode can be imported (the error is that of the first); or a bag already exists there.
pub fn import_droid(
    src: &Path,
    out: &Path,
    options: &ImportOptions,
) -> Result<Imported, ImportError> {
    let quality = options.jpeg_quality;
    let episodes = || -> Result<Box<dyn Iterator<Item = Found>>, ImportError> {
        Ok(match Source::find(src) {
            Ok(Source::Rlds(shards)) => Box::new(rlds::episodes(shards, quality)),
            _ => Box::new(droid::episodes(src, quality)?),
        })
    };
    run::import(episodes, src, out, options)
}
