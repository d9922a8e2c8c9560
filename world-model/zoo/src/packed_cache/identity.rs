//! Which state of which checkpoint it is.

use std::fs::Metadata;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Where a checkpoint lies, and what the system says of the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Stamp {
    /// Without links.
    pub(super) path: PathBuf,
    pub(super) state: State,
}

/// What changes when a file does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct State {
    length: u64,
    inode: u64,
    /// When its content was modified, in seconds and nanoseconds since 1970.
    modified: (i64, i64),
    /// When content, name, owner or rights were changed: always by the system's clock.
    changed: (i64, i64),
}

impl State {
    #[cfg(unix)]
    fn of(metadata: &Metadata) -> Option<Self> {
        use std::os::unix::fs::MetadataExt as _;
        Some(Self {
            length: metadata.len(),
            inode: metadata.ino(),
            modified: (metadata.mtime(), metadata.mtime_nsec()),
            changed: (metadata.ctime(), metadata.ctime_nsec()),
        })
    }

    pub(super) fn length(&self) -> u64 {
        self.length
    }

    /// Other systems do not tell when a file was changed.
    #[cfg(not(unix))]
    fn of(_: &Metadata) -> Option<Self> {
        None
    }
}

impl Stamp {
    /// Of the open file at `path`. `None` where the system does not say enough.
    pub(crate) fn new(path: &std::path::Path, metadata: &Metadata) -> Option<Self> {
        Some(Self {
            path: path.canonicalize().ok()?,
            state: State::of(metadata)?,
        })
    }

    /// Whether the file there is still this one.
    pub(super) fn is_current(&self) -> bool {
        let metadata = std::fs::metadata(&self.path);
        metadata.ok().and_then(|m| State::of(&m)) == Some(self.state)
    }

    /// Seconds since the last change, by the clock of this machine; negative if that is ahead of it.
    pub(super) fn age_seconds(&self) -> f64 {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        let (seconds, nanoseconds) = self.state.changed;
        now.map_or(0.0, |now| now.as_secs_f64()) - seconds as f64 - nanoseconds as f64 * 1e-9
    }
}

/// A state of a checkpoint, and which of its tensors.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Identity {
    pub(super) state: State,
    /// SHA-256 (hexadecimal) over the table of the tensors and samples of the file.
    pub(super) contents: String,
}
