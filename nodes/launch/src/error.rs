//! Errors of launch files.

use super::substitution::SubstitutionError;
use std::path::PathBuf;
use thiserror::Error;

/// A launch file cannot be read, is malformed, or cannot be resolved into processes. Each error names the file and the
/// entry.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages explain variants and fields")]
#[non_exhaustive]
pub enum LaunchError {
    /// The file cannot be read.
    #[error("cannot read the launch file {}", file.display())]
    Read {
        file: PathBuf,
        source: std::io::Error,
    },
    /// The file is not YAML.
    #[error("{}: not YAML", file.display())]
    Yaml {
        file: PathBuf,
        source: serde_yaml_ng::Error,
    },
    /// The entry has no such key.
    #[error("{}: {entry}: unknown key {key:?}; known keys: {}", file.display(), known.join(", "))]
    UnknownKey {
        file: PathBuf,
        /// The entry, for example `launch[3] node "encoder"`.
        entry: String,
        key: String,
        /// The keys that it may have.
        known: Vec<&'static str>,
    },
    /// A substitution is malformed or cannot be resolved.
    #[error("{}: {entry}: key {key:?}", file.display())]
    Substitution {
        file: PathBuf,
        entry: String,
        /// The key of the value.
        key: String,
        source: SubstitutionError,
    },
    /// Any other fault of an entry.
    #[error("{}: {entry}: {message}", file.display())]
    Entry {
        file: PathBuf,
        entry: String,
        /// What was expected and what was found.
        message: String,
    },
    /// The command line gives an argument that the file does not declare.
    #[error("launch argument {name:?} is not declared in {}; it declares: {}", file.display(), declared.join(", "))]
    UnknownArgument {
        file: PathBuf,
        name: String,
        /// The declared arguments.
        declared: Vec<String>,
    },
    /// The command line gives an argument twice.
    #[error("launch argument {name:?} is given twice, first as {first:?}")]
    RepeatedArgument {
        name: String,
        /// Its first value.
        first: String,
    },
}

impl LaunchError {
    /// Whether the command line is at fault, not the launch file.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::UnknownArgument { .. } | Self::RepeatedArgument { .. }
        )
    }
}
