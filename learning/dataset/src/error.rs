use std::path::{Path, PathBuf};

use thiserror::Error;

/// What recordings are read from.
const EXPECTED: &str = "bags (folders with metadata.yaml, or .mcap files), a folder of them, or one that \
                        `wm dataset BAGS --out FOLDER` prepared";

/// Why recordings cannot be trained on.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// There is nothing of this name.
    #[error(
        "{0}: no such file or folder; expected {EXPECTED}; `wm bag record` makes a bag, `wm sim --out FOLDER` simulated ones"
    )]
    Missing(PathBuf),
    /// No bag under the folder.
    #[error("{0}: found no recording; expected {EXPECTED}; `wm bag info PATH` says what is in one")]
    Empty(PathBuf),
    /// There are bags, but nothing in them can be used.
    #[error("no episode can be used:\n{0}")]
    Nothing(String),
    /// A bag does not belong to the others, or holds something it cannot use.
    #[error("{bag}: {what}")]
    Episode {
        /// The bag.
        bag: PathBuf,
        /// What was expected and what came.
        what: String,
    },
    /// An option that cannot serve.
    #[error("{option}: {what}")]
    Option {
        /// The option, as on the command line.
        option: &'static str,
        /// What was expected and what came.
        what: String,
    },
    /// A file of options or of an action space that cannot be understood.
    #[error("{path}: {what}")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// A prepared folder that is damaged, of another version, or does not fit what is asked for.
    #[error("{dir}: {what}")]
    Prepared {
        /// The folder.
        dir: PathBuf,
        /// What was expected and what came.
        what: String,
    },
    /// The folder to write exists.
    #[error("{0} exists already; give another folder, or remove this one")]
    Exists(PathBuf),
    /// Prepared pictures are smaller than those asked for.
    #[error(
        "{dir}: the prepared pictures have {}x{} pixels, but {}x{} are needed; prepare the bags again with --size {}x{}",
        stored.0, stored.1, asked.0, asked.1, asked.0, asked.1
    )]
    Upscaling {
        /// The prepared folder.
        dir: PathBuf,
        /// Height and width of a view in the folder.
        stored: (usize, usize),
        /// Height and width of a view that is asked for.
        asked: (usize, usize),
    },
    /// A file cannot be read or written.
    #[error("{path}: {reason}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why. No source, since the message has it.
        reason: std::io::Error,
    },
}

impl DatasetError {
    /// The error of an operation on a file.
    pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |reason| Self::Io { path, reason }
    }

    pub(super) fn file(path: &Path, what: impl ToString) -> Self {
        Self::File {
            path: path.to_owned(),
            what: what.to_string(),
        }
    }
}
