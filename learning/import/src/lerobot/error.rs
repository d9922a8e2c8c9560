use std::path::{Path, PathBuf};

use crate::ImportError;
use wm_bag::BagError;
use wm_motion::actions::ActionError;

/// A failure to read or write a data set. Each text names the file and the field, or the bag and the topic.
#[expect(missing_docs, reason = "the error texts describe variants and fields")]
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LeRobotError {
    #[error("{file}: {reason}")]
    Corrupt {
        file: PathBuf,
        /// The expected and the actual content, with the field.
        reason: String,
    },
    #[error("{bag}: {reason}")]
    Unsuited {
        bag: PathBuf,
        /// The expected and the actual content, with the topic.
        reason: String,
    },
    #[error(
        "{0} already exists and is not an empty folder; data sets are never overwritten, so choose another path"
    )]
    Exists(PathBuf),
    #[error("{0}")]
    Nothing(String),
    #[error("{file}: {reason}")]
    Io {
        file: PathBuf,
        /// The error. Not a `source`, since the text contains it.
        reason: std::io::Error,
    },
    /// A video cannot be read.
    #[error(transparent)]
    Video(#[from] ImportError),
    /// A bag cannot be read or written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The actions do not fit the action space.
    #[error(transparent)]
    Actions(#[from] ActionError),
}

impl LeRobotError {
    pub(crate) fn corrupt(file: &Path, reason: impl Into<String>) -> Self {
        Self::Corrupt {
            file: file.to_owned(),
            reason: reason.into(),
        }
    }

    pub(crate) fn unsuited(bag: &Path, reason: impl Into<String>) -> Self {
        Self::Unsuited {
            bag: bag.to_owned(),
            reason: reason.into(),
        }
    }

    /// The reason without the bag's name.
    pub(crate) fn reason(&self) -> String {
        match self {
            Self::Unsuited { reason, .. } => reason.clone(),
            other => other.to_string(),
        }
    }

    pub(crate) fn io(file: &Path, reason: std::io::Error) -> Self {
        Self::Io {
            file: file.to_owned(),
            reason,
        }
    }
}
