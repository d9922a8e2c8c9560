//! Errors of reports and comparisons.

use std::fmt;

use crate::MetricError;
use thiserror::Error;

/// Findings that cannot be written or compared.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FindingsError {
    /// Models measured with different settings or data.
    #[error(
        "findings of {model:?} cannot be compared with those of {baseline:?}: {}",
        list(mismatches)
    )]
    NotComparable {
        /// The baseline.
        baseline: String,
        /// The compared model.
        model: String,
        /// All differing settings.
        mismatches: Vec<Mismatch>,
    },
    /// A family without models.
    #[error("the family {family:?} has no model")]
    EmptyFamily {
        /// Name of the family.
        family: String,
    },
    /// Samples of a figure without an interval or a test.
    #[error("{metric}: {source}")]
    Statistics {
        /// Name of the figure.
        metric: String,
        /// Cause.
        source: MetricError,
    },
    /// A value without a JSON form.
    #[error("findings as JSON: {0}")]
    Json(#[from] serde_json::Error),
}

/// A setting that must be equal, but differs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mismatch {
    /// Path, such as `seed` or `settings.solver.steps`.
    pub what: String,
    /// Value of the baseline.
    pub baseline: String,
    /// Value of the compared model.
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
    let lines: Vec<String> = mismatches.iter().map(ToString::to_string).collect();
    lines.join("; ")
}
