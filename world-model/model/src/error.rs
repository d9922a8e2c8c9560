//! The one error type of the world model.

use std::path::PathBuf;

use crate::{Kernels, LatentSpace, NumberFormat};

/// Result with the error of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong in the world model; each message says what was expected and what came.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A tensor operation failed.
    #[error(transparent)]
    Candle(#[from] candle_core::Error),

    /// A file could not be read or written.
    #[error("{path}: {reason}", path = .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },

    /// The file is not a readable safetensors file (truncated, or not safetensors at all).
    #[error("{file}: not a valid safetensors file: {reason}")]
    CorruptWeights {
        /// Where the bytes came from.
        file: String,
        /// What the format check found.
        reason: String,
    },

    /// A tensor that the network needs is not in the file.
    #[error("{file}: tensor `{name}` of shape {expected:?} is missing")]
    MissingTensor {
        /// Where the bytes came from.
        file: String,
        /// Name of the tensor.
        name: String,
        /// Shape that the network needs.
        expected: Vec<usize>,
    },

    /// A tensor has another shape than the network needs.
    #[error("{file}: tensor `{name}` has shape {found:?}, expected {expected:?}")]
    TensorShape {
        /// Where the bytes came from.
        file: String,
        /// Name of the tensor.
        name: String,
        /// Shape that the network needs.
        expected: Vec<usize>,
        /// Shape in the file.
        found: Vec<usize>,
    },

    /// A tensor has a number format that is not f32, f16 or bf16.
    #[error("{file}: tensor `{name}` is of type {found}, expected F32, F16 or BF16")]
    TensorType {
        /// Where the bytes came from.
        file: String,
        /// Name of the tensor.
        name: String,
        /// Number format in the file.
        found: String,
    },

    /// A tensor holds NaN or infinity.
    #[error("{file}: tensor `{name}` has a value that is not finite")]
    TensorNotFinite {
        /// Where the bytes came from.
        file: String,
        /// Name of the tensor.
        name: String,
    },

    /// The file holds tensors that the network does not have.
    #[error("{file}: unexpected tensors: {}", .names.join(", "))]
    UnexpectedTensors {
        /// Where the bytes came from.
        file: String,
        /// Their names, sorted.
        names: Vec<String>,
    },

    /// A metadata entry of a weights file is missing or malformed.
    #[error("{file}: metadata entry `{key}`: {reason}")]
    Metadata {
        /// Where the bytes came from.
        file: String,
        /// The entry.
        key: String,
        /// What is wrong with it.
        reason: String,
    },

    /// A hash that a file states differs from the hash of what it holds.
    #[error("{file}: {what} is {found}, expected {expected}")]
    WrongHash {
        /// Where the bytes came from.
        file: String,
        /// What was hashed.
        what: &'static str,
        /// The hash that was stated.
        expected: String,
        /// The hash that was computed.
        found: String,
    },

    /// Latents of one space were given to a network of a different space.
    #[error("latents are from space {found}, expected {expected}")]
    LatentSpaceMismatch {
        /// The space that the network works in.
        expected: Box<LatentSpace>,
        /// The space that came.
        found: Box<LatentSpace>,
    },

    /// An input tensor has the wrong shape.
    #[error("{what} has shape {found:?}, expected {expected}")]
    Shape {
        /// What the tensor is.
        what: &'static str,
        /// The shape that was expected, with letters for free dimensions.
        expected: String,
        /// The shape that came.
        found: Vec<usize>,
    },

    /// An input holds NaN or infinity.
    #[error("{what} has a value that is not finite")]
    NotFinite {
        /// What the input is.
        what: &'static str,
    },

    /// A device cannot be used.
    #[error("device {device}: {reason}")]
    Device {
        /// Its name.
        device: String,
        /// Why it cannot be used.
        reason: String,
    },

    /// The kernels do not compute on a device.
    #[error("engine {kernels} does not support {device}; use engine candle (--engine candle)")]
    KernelsDevice {
        /// The kernels.
        kernels: Kernels,
        /// Name of the device.
        device: String,
    },

    /// The kernels do not compute in a number format.
    #[error(
        "engine {kernels} does not compute in {format}; use engine cpu (--engine cpu), on the CPU, or another dtype"
    )]
    KernelsFormat {
        /// The kernels.
        kernels: Kernels,
        /// The number format of the weights.
        format: NumberFormat,
    },

    /// A configuration value cannot be used.
    #[error("{field}: {reason}")]
    Config {
        /// The field.
        field: &'static str,
        /// What is wrong with it, with the value.
        reason: String,
    },
}

impl Error {
    /// An input/output error of `path`.
    pub fn io(path: impl Into<PathBuf>, reason: std::io::Error) -> Self {
        Self::Io {
            path: path.into(),
            reason,
        }
    }

    /// A configuration error of `field`.
    pub fn config(field: &'static str, reason: impl Into<String>) -> Self {
        Self::Config {
            field,
            reason: reason.into(),
        }
    }
}
