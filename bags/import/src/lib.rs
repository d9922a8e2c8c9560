//! Recorded robot episodes as bags: Bridge V2 in the two layouts in which it is passed around, and DROID.
//!
//! | layout | found by | cameras | actions | more |
//! |---|---|---|---|---|
//! | Bridge video | `NAME.mp4` (h264) beside `NAME.npz` | one | scaled for a model, undone here | |
//! | Bridge RLDS | a TFRecord (`*.tfrecord*`) of `tf.train.Example` | several | m, rad, gripper 0..1 | state, instruction |
//! | DROID | `annotation/SPLIT/NAME.json` beside `videos/` | three | from state to state | state, joints, instruction, success |
//!
//! Each episode becomes one bag, `episode_000000` and on; Bridge V2 at the 5 Hz at which it was recorded, DROID at the
//! rate of its videos:
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
//! let bags = import_bridge("bridge_v2".as_ref(), "bags".as_ref(), &ImportOptions::default())?;
//! println!("{} episodes", bags.len());
//! # Ok::<(), wm_import::ImportError>(())
//! ```
//!
//! The bag's metadata note where it came from ([`wm_bag::ORIGIN`], made by [`origin()`]).
//!
//! An episode is read whole before its bag is begun: bad input leaves no half a bag, and its error names the file.
//!
//! Not here: LeRobot datasets (`wm_lerobot`, which parquet makes heavy).

mod droid;
mod episode;
mod error;
mod jpeg;
mod mp4_npz;
mod origin;
mod rlds;
mod source;
#[cfg(test)]
mod testing;
pub mod video;

use std::path::{Path, PathBuf};

use episode::Unread;
pub use error::ImportError;
pub use jpeg::jpeg;
pub use origin::origin;
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
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            episodes: None,
            shard: Shard::WHOLE,
            jpeg_quality: 95,
            // Any fixed time serves, so that an import is reproducible; not 0, which ROS reads as "no time".
            start_ns: 1_700_000_000_000_000_000,
        }
    }
}

/// Imports Bridge V2 episodes: each becomes a bag `OUT/episode_NNNNNN`. The layout is found by what `src` holds.
///
/// `src` may be a directory, one `.mp4` or `.npz`, or one TFRecord. Gives the bags, in order; a shard may have none.
///
/// # Errors
/// `src` holds neither layout; a file is missing, corrupt or incomplete (the error names it); or a bag already exists
/// there.
pub fn import_bridge(
    src: &Path,
    out: &Path,
    options: &ImportOptions,
) -> Result<Vec<PathBuf>, ImportError> {
    let source = Source::find(src)?;
    let episodes: Box<dyn Iterator<Item = Result<Unread, ImportError>>> = match source {
        Source::Mp4Npz(pairs) => Box::new(mp4_npz::episodes(pairs, options.jpeg_quality)),
        Source::Rlds(shards) => Box::new(rlds::episodes(shards, options.jpeg_quality)),
    };
    write(episodes, src, out, options)
}

/// Imports DROID episodes: each becomes a bag `OUT/episode_NNNNNN`, in the order of folders, splits and numbers.
///
/// `src` has `annotation/` and `videos/` in it, or folders that have.
///
/// # Errors
/// `src` holds no such layout; a file is missing, corrupt or incomplete (the error names it); or a bag already exists
/// there.
pub fn import_droid(
    src: &Path,
    out: &Path,
    options: &ImportOptions,
) -> Result<Vec<PathBuf>, ImportError> {
    let episodes = droid::episodes(src, options.jpeg_quality)?;
    write(episodes, src, out, options)
}

/// Writes each episode of the shard as a bag; the others are not read.
fn write(
    episodes: impl Iterator<Item = Result<Unread, ImportError>>,
    src: &Path,
    out: &Path,
    options: &ImportOptions,
) -> Result<Vec<PathBuf>, ImportError> {
    let mut bags = Vec::new();
    let mut is_empty = true;
    for (number, unread) in episodes
        .take(options.episodes.unwrap_or(usize::MAX))
        .enumerate()
    {
        let unread = unread?;
        is_empty = false;
        if !options.shard.has(number) {
            continue;
        }
        let episode = unread()?;
        let bag = out.join(format!("episode_{number:06}"));
        episode.write(&bag, options.start_ns, &episode.origin(src))?;
        tracing::info!(
            source = %episode.source.display(), bag = %bag.display(),
            frames = episode.actions.len(), cameras = episode.cameras.len(), "imported"
        );
        bags.push(bag);
    }
    if is_empty {
        return Err(ImportError::NoEpisodes(src.to_owned()));
    }
    Ok(bags)
}
