use std::path::PathBuf;

use wm_bag::BagError;
use wm_motion::actions::ActionError;

/// Why episodes cannot be imported. Each text names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The path does not hold what is imported.
    #[error("{path} has no episodes: expected {expected}")]
    UnknownLayout {
        /// The path.
        path: PathBuf,
        /// The files that were looked for.
        expected: &'static str,
    },
    /// The layout is there, but no episode.
    #[error("{0} has no episodes")]
    NoEpisodes(PathBuf),
    /// The actions contradict what their values are.
    #[error(
        "{path}: the actions contradict their kinds in {contradicting} of {episodes} episodes: {reason}"
    )]
    Contradiction {
        /// The data set.
        path: PathBuf,
        /// Episodes that were measured.
        episodes: usize,
        /// Those of them that contradict by themselves.
        contradicting: usize,
        /// What was measured and expected, and the option that maps it.
        reason: String,
    },
    /// No episode can be imported.
    #[error("none of {count} episodes can be imported; the first: {first}")]
    NoneImported {
        /// Episodes.
        count: usize,
        /// Why the first cannot.
        first: Box<Self>,
    },
    /// A file that belongs to another is not there.
    #[error("{present} is incomplete: {missing} is missing")]
    Incomplete {
        /// The file that is there.
        present: PathBuf,
        /// The file that belongs to it.
        missing: PathBuf,
    },
    /// A file cannot be read as what it should be.
    #[error("{file}: {reason}")]
    Corrupt {
        /// The file.
        file: PathBuf,
        /// What was expected and what came.
        reason: String,
    },
    /// The operating system refused.
    #[error("{file}: {reason}")]
    Io {
        /// The file or directory.
        file: PathBuf,
        /// What it said. No source, since the message has it.
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
