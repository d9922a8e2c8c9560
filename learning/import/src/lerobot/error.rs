use std::path::{Path, PathBuf};

use crate::ImportError;
use wm_bag::BagError;
use wm_motion::actions::ActionError;

/// Why a data set cannot be read or written. Each text names the file and the field, or the bag and the topic.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LeRobotError {
    /// A file is not what it should be.
    #[error("{file}: {reason}")]
    Corrupt {
        /// The file.
        file: PathBuf,
        /// What was expected and what came, with the field's name.
        reason: String,
    },
    /// A bag does not hold what a data set needs.
    #[error("{bag}: {reason}")]
    Unsuited {
        /// The bag.
        bag: PathBuf,
        /// What was expected and what came, with the topic's name.
        reason: String,
    },
    /// The folder to write to holds something already.
    #[error(
        "{0} already exists and is not an empty folder; data sets are never overwritten, so choose another path"
    )]
    Exists(PathBuf),
    /// Nothing was requested.
    #[error("{0}")]
    Nothing(String),
    /// The operating system refused.
    #[error("{file}: {reason}")]
    Io {
        /// The file or folder.
        file: PathBuf,
        /// What it said. No source, since the message has it.
        reason: std::io::Error,
    },
    /// A video cannot be read.
    #[error(transparent)]
    Video(#[from] ImportError),
    /// A bag cannot be read or written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The dataset's actions are not those of the action space.
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
