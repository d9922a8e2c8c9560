//! What can be wrong with a launch file.

use super::substitution::SubstitutionError;
use std::path::PathBuf;
use thiserror::Error;

/// A launch file that cannot be read, is malformed, or cannot be resolved into processes. Each names the file,
/// and the entry within it; where there is a cause, it is the error's source.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LaunchError {
    /// The file cannot be read.
    #[error("cannot read the launch file {}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not YAML.
    #[error("{}: not YAML", file.display())]
    Yaml {
        /// The file.
        file: PathBuf,
        /// Where and why.
        source: serde_yaml_ng::Error,
    },
    /// A key that the entry does not have.
    #[error("{}: {entry}: unknown key {key:?}; known keys: {}", file.display(), known.join(", "))]
    UnknownKey {
        /// The file.
        file: PathBuf,
        /// The entry, for example `launch[3] node "encoder"`.
        entry: String,
        /// The key.
        key: String,
        /// The keys that it may have.
        known: Vec<&'static str>,
    },
    /// A substitution that does not parse, or stands for nothing.
    #[error("{}: {entry}: key {key:?}", file.display())]
    Substitution {
        /// The file.
        file: PathBuf,
        /// The entry.
        entry: String,
        /// The key whose value it is in.
        key: String,
        /// What is wrong.
        source: SubstitutionError,
    },
    /// Anything else that is wrong with one entry.
    #[error("{}: {entry}: {message}", file.display())]
    Entry {
        /// The file.
        file: PathBuf,
        /// The entry.
        entry: String,
        /// What was expected and what came.
        message: String,
    },
    /// An argument on the command line that the file does not declare.
    #[error("launch argument {name:?} is not declared in {}; it declares: {}", file.display(), declared.join(", "))]
    UnknownArgument {
        /// The file.
        file: PathBuf,
        /// The argument.
        name: String,
        /// What the file declares.
        declared: Vec<String>,
    },
    /// An argument that the command line gives twice.
    #[error("launch argument {name:?} is given twice, first as {first:?}")]
    RepeatedArgument {
        /// The argument.
        name: String,
        /// Its first value.
        first: String,
    },
}

impl LaunchError {
    /// Whether the command line is wrong, as opposed to the launch file.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::UnknownArgument { .. } | Self::RepeatedArgument { .. }
        )
    }
}
