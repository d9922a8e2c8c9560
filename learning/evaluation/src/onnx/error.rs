//! The one error type of this crate.

use std::path::PathBuf;

use crate::onnx::{Digest, Role};

/// Result with the error of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong with a network; each message names the role and the file, what was expected and what came.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read.
    #[error("{file}: {reason}", file = .file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// What the system said. No source, since the message has it.
        reason: std::io::Error,
    },

    /// `networks.yaml` is not a description of networks.
    #[error("{file}: {reason}", file = .file.display())]
    Yaml {
        /// The file.
        file: PathBuf,
        /// What is wrong, and where.
        reason: serde_yaml_ng::Error,
    },

    /// A key of `networks.yaml` has a value that cannot be, or is missing.
    #[error("{file}: {role}: {key}: {reason}", file = .file.display())]
    Key {
        /// The file.
        file: PathBuf,
        /// Under which role.
        role: Role,
        /// Which key, such as `input.size`.
        key: &'static str,
        /// What is wrong with it.
        reason: String,
    },

    /// No network has this role.
    #[error("{}; {file} may name one", .role.not_measured(), file = .file.display())]
    Absent {
        /// The role.
        role: Role,
        /// Where the network would be named.
        file: PathBuf,
    },

    /// The role's network gives something else.
    #[error("{role}: its network does not give {asked}")]
    Role {
        /// The role.
        role: Role,
        /// What was asked of it.
        asked: &'static str,
    },

    /// The program was built without a runtime for ONNX files.
    #[error(
        "{role}: {file}: this program was built without ONNX; build it with the feature `onnx` \
         (cargo build --features onnx)",
        file = .file.display()
    )]
    NoRuntime {
        /// The role.
        role: Role,
        /// The network's file.
        file: PathBuf,
    },

    /// The file is not the one that `networks.yaml` means.
    #[error("{role}: {file}: SHA-256 expected {expected}, found {found}", file = .file.display())]
    Digest {
        /// The role.
        role: Role,
        /// The network's file.
        file: PathBuf,
        /// As stated in `networks.yaml`.
        expected: Digest,
        /// Of the file.
        found: Digest,
    },

    /// The file is not a network that can be run: damaged, too large, or with an operator that the runtime lacks.
    #[error("{role}: {file}: not a network that can be run: {reason}", file = .file.display())]
    Unusable {
        /// The role.
        role: Role,
        /// The network's file.
        file: PathBuf,
        /// What the runtime said.
        reason: String,
    },

    /// The network failed while it ran.
    #[error("{role}: {file}: {reason}", file = .file.display())]
    Run {
        /// The role.
        role: Role,
        /// The network's file.
        file: PathBuf,
        /// What the runtime said.
        reason: String,
    },

    /// An input or an output has another shape than the role's.
    #[error("{role}: {file}: {tensor}: expected {expected}, found {found}", file = .file.display())]
    Shape {
        /// The role.
        role: Role,
        /// The network's file.
        file: PathBuf,
        /// Which input or output.
        tensor: String,
        /// The shape that the role asks for.
        expected: String,
        /// The shape that is there, or what is there in its stead.
        found: String,
    },

    /// An output has a number that is infinite or none.
    #[error("{role}: {file}: {tensor}: {value} at element {index}", file = .file.display())]
    NotFinite {
        /// The role.
        role: Role,
        /// The network's file.
        file: PathBuf,
        /// Which output.
        tensor: String,
        /// First element that is not finite.
        index: usize,
        /// What it is.
        value: f32,
    },

    /// A picture, a clip or a query that the network cannot take.
    #[error("{role}: {what}: expected {expected}, found {found}")]
    Input {
        /// The role.
        role: Role,
        /// What was given.
        what: &'static str,
        /// What the network takes.
        expected: String,
        /// What came.
        found: String,
    },
}
