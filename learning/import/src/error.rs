use std::path::PathBuf;

use wm_bag::BagError;
use wm_motion::actions::ActionError;

/// A failure of an import. Each text names the file.
#[expect(missing_docs, reason = "the error texts describe variants and fields")]
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    #[error("{path} has no episodes: expected {expected}")]
    UnknownLayout {
        path: PathBuf,
        expected: &'static str,
    },
    #[error("{0} has no episodes")]
    NoEpisodes(PathBuf),
    #[error(
        "{path}: the actions contradict their kinds in {contradicting} of {episodes} episodes: {reason}"
    )]
    Contradiction {
        path: PathBuf,
        episodes: usize,
        /// Number of episodes that contradict by themselves.
        contradicting: usize,
        /// Measured and expected values, and the option that maps them.
        reason: String,
    },
    #[error("none of {count} episodes can be imported; the first: {first}")]
    NoneImported { count: usize, first: Box<Self> },
    #[error("{present} is incomplete: {missing} is missing")]
    Incomplete { present: PathBuf, missing: PathBuf },
    #[error("{file}: {reason}")]
    Corrupt {
        file: PathBuf,
        /// The expected and the actual content.
        reason: String,
    },
    #[error("{file}: {reason}")]
    Io {
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
