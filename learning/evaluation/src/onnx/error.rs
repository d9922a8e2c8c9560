//! Errors of networks.

use std::path::PathBuf;

use crate::onnx::{Digest, Role};

/// Result of this module.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Errors of networks; each message names the role, the file, the expectation and the finding.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read.
    #[error("{file}: {reason}", file = .file.display())]
    Io {
        /// Path of the file.
        file: PathBuf,
        /// Cause; not a `source`, since the message includes it.
        reason: std::io::Error,
    },

    /// `networks.yaml` is not a description of networks.
    #[error("{file}: {reason}", file = .file.display())]
    Yaml {
        /// The file.
        file: PathBuf,
        /// Fault with its location.
        reason: serde_yaml_ng::Error,
    },

    /// A missing or invalid key of `networks.yaml`.
    #[error("{file}: {role}: {key}: {reason}", file = .file.display())]
    Key {
        /// Path of the file.
        file: PathBuf,
        /// Role of the network.
        role: Role,
        /// Key, such as `input.size`.
        key: &'static str,
        /// Fault.
        reason: String,
    },

    /// A role without a network.
    #[error("{}; add one to {file}", .role.not_measured(), file = .file.display())]
    MissingNetwork {
        /// The role.
        role: Role,
        /// File to add it to.
        file: PathBuf,
    },

    /// A network with another output.
    #[error("{role}: the network does not give {requested}")]
    Role {
        /// The role.
        role: Role,
        /// Requested output.
        requested: &'static str,
    },

    /// A build without an ONNX runtime.
    #[error(
        "{role}: {file}: this program was built without ONNX; build it with the feature `onnx` \
         (cargo build --features onnx)",
        file = .file.display()
    )]
    NoRuntime {
        /// The role.
        role: Role,
        /// Path of the network.
        file: PathBuf,
    },

    /// A file other than the one in `networks.yaml`.
    #[error("{role}: {file}: SHA-256 expected {expected}, found {found}", file = .file.display())]
    Digest {
        /// The role.
        role: Role,
        /// Path of the network.
        file: PathBuf,
        /// Digest in `networks.yaml`.
        expected: Digest,
        /// Digest of the file.
        found: Digest,
    },

    /// A file that cannot run: damaged, too large, or with an unsupported operator.
    #[error("{role}: {file}: not a network that can be run: {reason}", file = .file.display())]
    Unusable {
        /// The role.
        role: Role,
        /// Path of the network.
        file: PathBuf,
        /// Message of the runtime.
        reason: String,
    },

    /// A failed run.
    #[error("{role}: {file}: {reason}", file = .file.display())]
    Run {
        /// The role.
        role: Role,
        /// Path of the network.
        file: PathBuf,
        /// Message of the runtime.
        reason: String,
    },

    /// An input or output of the wrong shape.
    #[error("{role}: {file}: {tensor}: expected {expected}, found {found}", file = .file.display())]
    Shape {
        /// The role.
        role: Role,
        /// Path of the network.
        file: PathBuf,
        /// Name of the input or output.
        tensor: String,
        /// Shape required by the role.
        expected: String,
        /// Shape found, or its replacement.
        found: String,
    },

    /// An output with an infinite or NaN value.
    #[error("{role}: {file}: {tensor}: {value} at element {index}", file = .file.display())]
    NotFinite {
        /// The role.
        role: Role,
        /// Path of the network.
        file: PathBuf,
        /// Name of the output.
        tensor: String,
        /// Index of the first such element.
        index: usize,
        /// Value.
        value: f32,
    },

    /// An unsuitable picture, clip or query.
    #[error("{role}: {what}: expected {expected}, found {found}")]
    Input {
        /// The role.
        role: Role,
        /// Kind of input.
        what: &'static str,
        /// Accepted.
        expected: String,
        /// Found.
        found: String,
    },
}
