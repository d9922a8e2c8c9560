//! Why findings cannot be told or compared.

use std::fmt;

use crate::MetricError;
use thiserror::Error;

/// Why findings cannot be told or compared.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FindingsError {
    /// They were not measured alike, so that a difference would not be the models'.
    #[error(
        "findings of {model:?} cannot be compared with those of {baseline:?}: {}",
        list(mismatches)
    )]
    NotComparable {
        /// The model that others are compared with.
        baseline: String,
        /// The model that was to be compared.
        model: String,
        /// All that differs.
        mismatches: Vec<Mismatch>,
    },
    /// A figure's samples have no interval or no test.
    #[error("{metric}: {source}")]
    Statistics {
        /// The figure.
        metric: String,
        /// Why not.
        source: MetricError,
    },
    /// Something has no JSON.
    #[error("findings as JSON: {0}")]
    Json(#[from] serde_json::Error),
}

/// Something that must be equal for findings to be compared, and is not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mismatch {
    /// What, as `seed` or `settings.solver.steps`.
    pub what: String,
    /// That of the baseline.
    pub baseline: String,
    /// That of the model to be compared.
    pub model: String,
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            what,
            baseline,
            model,
        } = self;
        write!(f, "{what} is {model}, expected {baseline}")
    }
}

fn list(mismatches: &[Mismatch]) -> String {
    let told: Vec<String> = mismatches.iter().map(ToString::to_string).collect();
    told.join("; ")
}
