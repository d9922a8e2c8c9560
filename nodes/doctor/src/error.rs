//! Errors of an examination.

use std::path::PathBuf;
use thiserror::Error;

/// Why an examination failed. Faults of the examined system are [`Finding`](wm_audit::Finding)s.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages explain variants and fields")]
#[non_exhaustive]
pub enum DoctorError {
    /// The graph cannot be joined, or arguments or variables are wrong.
    #[error(transparent)]
    Ros(#[from] wm_ros::Error),
    /// A file of the system cannot be read.
    #[error("cannot read {}", file.display())]
    System {
        file: PathBuf,
        source: std::io::Error,
    },
    /// A part of a model fails.
    #[error("{part}")]
    Model {
        /// The part, for example `the encoder`.
        part: &'static str,
        source: Box<wm_zoo::Error>,
    },
}

impl DoctorError {
    /// Wraps the error of a part of a model.
    pub(crate) fn of<E: Into<wm_zoo::Error>>(part: &'static str) -> impl FnOnce(E) -> Self {
        move |source| Self::Model {
            part,
            source: Box::new(source.into()),
        }
    }

    /// Whether the user's arguments or variables are wrong.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::Ros(error) if error.is_usage() || matches!(error, wm_ros::Error::Environment { .. }))
    }
}
