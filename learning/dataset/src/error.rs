use std::path::{Path, PathBuf};

use thiserror::Error;
use wm_motion::actions::ActionError;

/// Accepted inputs.
const EXPECTED: &str = "bags (folders with metadata.yaml, or .mcap files), a folder of them, or one that \
                        `wm dataset BAGS --out FOLDER` prepared";

/// Recordings that cannot be used for training.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// A missing path.
    #[error(
        "{0}: no such file or folder; expected {EXPECTED}; record a bag with `wm bag record`, or simulate with `wm sim --out FOLDER`"
    )]
    Missing(PathBuf),
    /// No bag under the folder.
    #[error("{0}: found no recording; expected {EXPECTED}; inspect one with `wm bag info PATH`")]
    Empty(PathBuf),
    /// Bags without any usable episode.
    #[error("no episode can be used:\n{0}")]
    Nothing(String),
    /// A bag that differs from the others, or has invalid contents.
    #[error("{bag}: {what}")]
    Episode {
        /// Path of the bag.
        bag: PathBuf,
        /// Expected and found.
        what: String,
    },
    /// An invalid option.
    #[error("{option}: {what}")]
    Option {
        /// Name on the command line.
        option: &'static str,
        /// Expected and found.
        what: String,
    },
    /// An invalid file of options or of an action space.
    #[error("{path}: {what}")]
    File {
        /// Path of the file.
        path: PathBuf,
        /// The fault.
        what: String,
    },
    /// A prepared folder that is damaged, of another version, or unsuitable.
    #[error("{dir}: {what}")]
    Prepared {
        /// Path of the folder.
        dir: PathBuf,
        /// Expected and found.
        what: String,
    },
    /// An existing output folder.
    #[error("{0} exists already; give another folder, or remove this one")]
    Exists(PathBuf),
    /// Prepared pictures that are too small.
    #[error(
        "{dir}: the prepared pictures have {}x{} pixels, but {}x{} are needed; prepare the bags again with --size {}x{}",
        stored.0, stored.1, requested.0, requested.1, requested.0, requested.1
    )]
    Upscaling {
        /// Path of the folder.
        dir: PathBuf,
        /// Height and width of a stored view.
        stored: (usize, usize),
        /// Height and width of a requested view.
        requested: (usize, usize),
    },
    /// A file that cannot be read or written.
    #[error("{path}: {reason}")]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Cause; not a `source`, since the message includes it.
        reason: std::io::Error,
    },
}

impl DatasetError {
    /// An error with this path.
    pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |reason| Self::Io { path, reason }
    }

    /// No scale fits the actions.
    pub(super) fn of_scales(error: ActionError) -> Self {
        Self::Option {
            option: "--action-space",
            what: error.to_string(),
        }
    }

    pub(super) fn file(path: &Path, what: impl ToString) -> Self {
        Self::File {
            path: path.to_owned(),
            what: what.to_string(),
        }
    }
}
