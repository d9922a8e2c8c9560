use thiserror::Error;

/// Why a metric has no value.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum MetricError {
    /// The two images, or an image and its mask or flow, differ in size (width, height).
    #[error("sizes differ: {first:?} against {second:?} (width, height)")]
    Size {
        /// Size of the first.
        first: (u32, u32),
        /// Size of the second.
        second: (u32, u32),
    },
    /// Smaller than the window of the metric.
    #[error("an image of {size:?} (width, height) is smaller than the window of {window}x{window}")]
    TooSmall {
        /// The image's size.
        size: (u32, u32),
        /// The window's side.
        window: u32,
    },
    /// Nothing to count: no pixel, an empty mask, or no value.
    #[error("nothing to compare: the images, the mask, or the values are empty")]
    Empty,
    /// Two vectors of different length.
    #[error("lengths differ: {first} against {second} values")]
    Length {
        /// Length of the first.
        first: usize,
        /// Length of the second.
        second: usize,
    },
    /// Fewer than the metric is defined for.
    #[error("too few {what}: expected at least {expected}, got {actual}")]
    TooFew {
        /// What there is too little of.
        what: &'static str,
        /// The least that is enough.
        expected: usize,
        /// How many came.
        actual: usize,
    },
    /// NaN or infinite.
    #[error("expected finite {what}, but number {index} is not")]
    NotFinite {
        /// Whose values.
        what: &'static str,
        /// The first such value, counted from 0.
        index: usize,
    },
    /// What must vary is the same everywhere.
    #[error("expected {what} to vary, but all are equal")]
    Constant {
        /// What never varies.
        what: &'static str,
    },
    /// Columns that are, or nearly are, sums of others.
    #[error(
        "expected independent columns of the {what}, but they are linearly dependent: {columns} columns in {rows} rows"
    )]
    Singular {
        /// Whose columns.
        what: &'static str,
        /// Number of rows.
        rows: usize,
        /// Number of columns.
        columns: usize,
    },
    /// Outside of what a setting or a value may be.
    #[error("expected {what} {expected}, got {actual}")]
    Range {
        /// Which value.
        what: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What came.
        actual: String,
    },
}

/// That both hold as many values, and at least one.
pub(crate) fn same_length(first: usize, second: usize) -> Result<(), MetricError> {
    if first != second {
        return Err(MetricError::Length { first, second });
    }
    if first == 0 {
        return Err(MetricError::Empty);
    }
    Ok(())
}

/// That there are enough.
pub(crate) fn at_least(
    what: &'static str,
    expected: usize,
    actual: usize,
) -> Result<(), MetricError> {
    if actual < expected {
        return Err(MetricError::TooFew {
            what,
            expected,
            actual,
        });
    }
    Ok(())
}

/// That no value is NaN or infinite.
pub(crate) fn finite(
    what: &'static str,
    values: impl IntoIterator<Item = f64>,
) -> Result<(), MetricError> {
    match values.into_iter().position(|value| !value.is_finite()) {
        Some(index) => Err(MetricError::NotFinite { what, index }),
        None => Ok(()),
    }
}

/// That not all values are equal.
pub(crate) fn varying(what: &'static str, values: &[f64]) -> Result<(), MetricError> {
    match values.split_first() {
        Some((first, others)) if others.iter().any(|other| other != first) => Ok(()),
        _ => Err(MetricError::Constant { what }),
    }
}

/// The mean; of nothing NaN, so that callers look at the length before.
pub(crate) fn mean(values: &[f64]) -> f64 {
    // Counts stay far below 2^52.
    values.iter().sum::<f64>() / values.len() as f64
}
