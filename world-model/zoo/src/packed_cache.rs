//! Packed weights that are kept as files.
//!
//! Kernels read weights in an order of their own. Loading a model packs them, into memory of the process. A cache keeps
//! them as packed in a file, so that a later start maps the file instead: nothing is copied, and all processes that run
//! the model share one copy of it, which the system can drop and read again.
//!
//! A file is named by what it was made of: the checkpoint's path, which part of it, the number format, and the first
//! matrix that the model asks for. What it holds is for one state of the checkpoint, one order of packing
//! ([`packed_layout`](wm_model::ops::packed_layout)) and one set of instructions. Whatever differs, or is damaged, is
//! packed anew, and the file replaced.
//!
//! - **The checkpoint is known** by its size, its inode, the times of its last modification and of its last change of any
//!   kind (which no program can set), and a hash of the table of its tensors with samples of their values. A hash of all
//!   values would have to read the whole checkpoint, which takes as long as packing it, and on a slow disk twice as long
//!   as having no cache. Of torch files, which state checksums of all values, these are part of the hash.
//! - **Damage** is found by a checksum of every matrix before it is used, which also reads the file once.
//! - **Files** are written beside their place, made read-only and renamed, and never changed: who has one mapped keeps
//!   it. A thread writes while the model already runs, and who finds another process at it leaves it to that one.
//! - **Their size is bounded**: those that were not used for the longest time are deleted. None is written where it would
//!   not leave as much free again.
//!
//! Only the matrices of Linears are kept. Convolutions are packed at each start: their models are small.
//!
//! No process has a cache unless it [says so](PackedCache::use_in_process). Nothing depends on one: what keeps it from
//! reading or writing is logged, and the model is packed as without.

mod environment;
mod header;
mod identity;
mod packed_file;
mod session;
mod store;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

pub(crate) use identity::Stamp;
pub(crate) use session::Session;

/// How much a [`PackedCache`] keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CacheLimits {
    /// Models whose matrices take fewer bytes are packed faster than looked up.
    pub least: u64,
    /// Bytes of all files together.
    pub most: u64,
    /// How long a checkpoint must not have changed: what is being written is no state that will be found again.
    pub settled: Duration,
}

impl Default for CacheLimits {
    fn default() -> Self {
        Self {
            least: 64 << 20,
            most: 16 << 30,
            settled: Duration::from_secs(2),
        }
    }
}

/// A folder of packed weights. Clones are the same one.
#[derive(Clone, Debug)]
pub struct PackedCache {
    folder: PathBuf,
    limits: CacheLimits,
    writers: Arc<Mutex<Vec<JoinHandle<()>>>>,
}

static OF_PROCESS: OnceLock<PackedCache> = OnceLock::new();

impl PackedCache {
    /// One in `folder`, which is created when there is something to keep.
    pub fn new(folder: impl Into<PathBuf>, limits: CacheLimits) -> Self {
        Self {
            folder: folder.into(),
            limits,
            writers: Arc::default(),
        }
    }

    /// Has every loader of this process use this cache from now on. The first one that is set stays.
    pub fn use_in_process(self) {
        OF_PROCESS.get_or_init(|| self);
    }

    /// That of the process, if it has one.
    pub(crate) fn of_process() -> Option<Self> {
        OF_PROCESS.get().cloned()
    }

    /// Waits until all that is being written to it by this process is there.
    pub fn wait(&self) {
        let writers = std::mem::take(&mut *self.writers());
        for writer in writers {
            // A writer that panicked has written nothing; who waits has the model all the same.
            writer.join().ok();
        }
    }

    /// Where its files are.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn writers(&self) -> std::sync::MutexGuard<'_, Vec<JoinHandle<()>>> {
        self.writers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests;
