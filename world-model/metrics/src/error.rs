use thiserror::Error;

/// A metric without a value.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum MetricError {
    /// Two images, or an image and its mask or flow, differ in size.
    #[error("sizes differ: {first:?} against {second:?} (width, height)")]
    Size {
        /// Size of the first.
        first: (u32, u32),
        /// Size of the second.
        second: (u32, u32),
    },
    /// An image smaller than the window of the metric.
    #[error("an image of {size:?} (width, height) is smaller than the window of {window}x{window}")]
    TooSmall {
        /// Size of the image \[px\].
        size: (u32, u32),
        /// Side of the window \[px\].
        window: u32,
    },
    /// No pixel, an empty mask, or no value.
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
    /// Too few samples for the metric.
    #[error("too few {what}: expected at least {expected}, got {actual}")]
    TooFew {
        /// Name of the samples.
        what: &'static str,
        /// Least number.
        expected: usize,
        /// Number found.
        actual: usize,
    },
    /// NaN or infinite values.
    #[error("expected finite {what}, but number {index} is not")]
    NotFinite {
        /// Name of the values.
        what: &'static str,
        /// Index of the first such value.
        index: usize,
    },
    /// A constant that must vary.
    #[error("expected {what} to vary, but all are equal")]
    Constant {
        /// What never varies.
        what: &'static str,
    },
    /// Linearly dependent columns.
    #[error(
        "expected independent columns of the {what}, but they are linearly dependent: {columns} columns in {rows} rows"
    )]
    Singular {
        /// Name of the table.
        what: &'static str,
        /// Number of rows.
        rows: usize,
        /// Number of columns.
        columns: usize,
    },
    /// A setting or value out of range.
    #[error("expected {what} {expected}, got {actual}")]
    Range {
        /// Name of the value.
        what: &'static str,
        /// Accepted range.
        expected: &'static str,
        /// Value found.
        actual: String,
    },
}

pub(crate) fn same_length(first: usize, second: usize) -> Result<(), MetricError> {
    if first != second {
        return Err(MetricError::Length { first, second });
    }
    if first == 0 {
        return Err(MetricError::Empty);
    }
    Ok(())
}

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

pub(crate) fn finite(
    what: &'static str,
    values: impl IntoIterator<Item = f64>,
) -> Result<(), MetricError> {
    match values.into_iter().position(|value| !value.is_finite()) {
        Some(index) => Err(MetricError::NotFinite { what, index }),
        None => Ok(()),
    }
}

pub(crate) fn varying(what: &'static str, values: &[f64]) -> Result<(), MetricError> {
    match values.split_first() {
        Some((first, others)) if others.iter().any(|other| other != first) => Ok(()),
        _ => Err(MetricError::Constant { what }),
    }
}

/// The mean; NaN if empty, so callers check the length first.
pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
