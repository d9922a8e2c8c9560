use std::path::PathBuf;

use wm_bag::BagError;
use wm_motion::actions::ActionError;

/// A failure of an import. Each text names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The path has no known layout.
    #[error("{path} has no episodes: expected {expected}")]
    UnknownLayout {
        /// The path.
        path: PathBuf,
        /// The expected files.
        expected: &'static str,
    },
    /// The layout has no episodes.
    #[error("{0} has no episodes")]
    NoEpisodes(PathBuf),
    /// The actions contradict their kinds.
    #[error(
        "{path}: the actions contradict their kinds in {contradicting} of {episodes} episodes: {reason}"
    )]
    Contradiction {
        /// The data set.
        path: PathBuf,
        /// Number of measured episodes.
        episodes: usize,
        /// Number of episodes that contradict by themselves.
        contradicting: usize,
        /// Measured and expected values, and the option that maps them.
        reason: String,
    },
    /// No episode can be imported.
    #[error("none of {count} episodes can be imported; the first: {first}")]
    NoneImported {
        /// Number of episodes.
        count: usize,
        /// The fault of the first.
        first: Box<Self>,
    },
    /// A file of a pair is missing.
    #[error("{present} is incomplete: {missing} is missing")]
    Incomplete {
        /// The existing file.
        present: PathBuf,
        /// The missing file.
        missing: PathBuf,
    },
    /// A file is invalid.
    #[error("{file}: {reason}")]
    Corrupt {
        /// The file.
        file: PathBuf,
        /// The expected and the actual content.
        reason: String,
    },
    /// An error of the operating system.
    #[error("{file}: {reason}")]
    Io {
        /// The file or directory.
        file: PathBuf,
        /// The error. Not a `source`, since the text contains it.
        reason: std::io::Error,
    },
    /// The bag cannot be written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The description of the action space cannot be written.
    #[error(transparent)]
    Actions(#[from] ActionError),
}

impl ImportError {
    pub(crate) fn corrupt(file: impl Into<PathBuf>, reason: impl Into<String>) -> Self {
        Self::Corrupt {
            file: file.into(),
            reason: reason.into(),
        }
    }

    pub(crate) fn io(file: impl Into<PathBuf>, reason: std::io::Error) -> Self {
        Self::Io {
            file: file.into(),
            reason,
        }
    }
}
