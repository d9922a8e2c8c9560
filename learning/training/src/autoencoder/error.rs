use std::path::PathBuf;

use thiserror::Error;
use wm_dataset::DatasetError;

use crate::optimiser::OptimiserError;

/// A failed training.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TrainingError {
    /// Unusable data.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A model that cannot be made, run or saved.
    #[error(transparent)]
    Model(#[from] wm_model::Error),
    /// A failed step or checkpoint.
    #[error(transparent)]
    Optimiser(#[from] OptimiserError),
    /// A failed tensor operation.
    #[error(transparent)]
    Tensor(#[from] candle_core::Error),
    /// A file that cannot be written.
    #[error("{path}: {source}", path = .path.display())]
    Io {
        /// Path of the file or folder.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// Pictures of another size than the model's.
    #[error("the frames are {found:?} (height, width), expected {expected:?}")]
    FrameSize {
        /// Size of the model.
        expected: (usize, usize),
        /// Size of the dataset.
        found: (usize, usize),
    },
}
