//! Correlation of two lists or tables of numbers.

mod canonical;
mod pairs;

pub use canonical::{CanonicalCorrelation, Regularisation, trace_correlation};
pub use pairs::{Correlation, pearson, spearman};
