//! The one error type of the model library.

use std::fmt;
use std::path::PathBuf;

/// Result with the error of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong with checkpoints and models; each message says what was expected and what came.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A configuration, an input, or a part of the world model.
    #[error(transparent)]
    Model(#[from] wm_model::Error),

    /// A tensor operation failed.
    #[error(transparent)]
    Candle(#[from] candle_core::Error),

    /// A file could not be read or written.
    #[error("{path}: {reason}", path = .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said. No source, since the message has it.
        reason: std::io::Error,
    },

    /// There is no world model of this name.
    #[error(
        "{name}: {found}; a model is `tiny`, or a folder as `wm train model --out FOLDER` makes it"
    )]
    NoModel {
        /// What was asked for.
        name: String,
        /// What is there instead.
        found: &'static str,
    },

    /// A model of which only the parts before the transition model are there.
    #[error(
        "{name}: there is no transition model in it, so it encodes and decodes but predicts nothing; if its training was \
         stopped, the same command goes on with it; else `wm train transition --data BAGS --encoder {name} --out {name}` \
         adds one"
    )]
    NoTransition {
        /// What was asked for.
        name: String,
    },

    /// The file is neither safetensors nor a torch checkpoint, or is damaged.
    #[error("{file}: not a readable checkpoint: {reason}")]
    Corrupt {
        /// Where the bytes came from.
        file: String,
        /// What is wrong with it.
        reason: String,
    },

    /// There is no such part in a checkpoint of several.
    #[error("{file}: no tensors under `{part}`; the file has: {}", .found.join(", "))]
    NoSuchPart {
        /// Where the bytes came from.
        file: String,
        /// What was requested.
        part: String,
        /// First components of the names that are there.
        found: Vec<String>,
    },

    /// The checkpoint's tensors are not those of the model; all differences together.
    #[error(
        "{file}: the tensors are not the model's{}{}{}",
        list("missing", missing),
        list("of another shape", misshapen),
        list("unexpected", unexpected)
    )]
    Tensors {
        /// Where the bytes came from.
        file: String,
        /// What the model needs and the file has not: `name [shape]`, in the order in which it was asked for.
        missing: Vec<String>,
        /// What has another shape than the model needs.
        misshapen: Vec<Misshapen>,
        /// What the file has and the model does not know.
        unexpected: Vec<String>,
    },

    /// A part of a model folder cannot be used.
    #[error("{file}: {role}: {reason}")]
    Part {
        /// The folder's `model.json`.
        file: String,
        /// Which part: `encoder`, `adapter`, ...
        role: &'static str,
        /// Why not. No source, since the message has it.
        reason: Box<Error>,
    },

    /// A calibration is of other weights.
    #[error(
        "{file}: its {part} has the weights {calibrated}, that of the model {found}; calibrate again (wm model calibrate \
         --overwrite) or delete the file",
        file = .file.display()
    )]
    Calibration {
        /// The file.
        file: PathBuf,
        /// Which part of the model: `encoder`, ...
        part: &'static str,
        /// The weights that it is of.
        calibrated: String,
        /// Those of the model.
        found: String,
    },

    /// A file with a configuration is not valid.
    #[error("{file}: {reason}")]
    ConfigFile {
        /// The file.
        file: String,
        /// What is wrong with it.
        reason: String,
    },
}

/// A tensor of another shape than the model needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Misshapen {
    /// Name of the tensor.
    pub name: String,
    /// Shape that the model needs.
    pub expected: Vec<usize>,
    /// Shape in the file.
    pub found: Vec<usize>,
}

impl fmt::Display for Misshapen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            name,
            expected,
            found,
        } = self;
        write!(f, "{name} {found:?}, expected {expected:?}")
    }
}

impl Error {
    /// An input/output error of `path`.
    pub(crate) fn io(path: impl Into<PathBuf>, reason: std::io::Error) -> Self {
        Self::Io {
            path: path.into(),
            reason,
        }
    }
}

/// For what [`wm_model`] asks of encoders, decoders and sources of tensors.
impl From<Error> for wm_model::Error {
    fn from(error: Error) -> Self {
        match error {
            Error::Model(error) => error,
            Error::Candle(error) => error.into(),
            other => candle_core::Error::Msg(other.to_string()).into(),
        }
    }
}

/// A heading and the items under it, one a line; nothing if there are none.
fn list<T: fmt::Display>(heading: &str, items: &[T]) -> String {
    let mut text = String::new();
    if !items.is_empty() {
        text = format!("\n{heading} ({}):", items.len());
        for item in items {
            text.push_str(&format!("\n  {item}"));
        }
    }
    text
}
