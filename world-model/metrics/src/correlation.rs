//! How strongly two lists, or two tables, of numbers go together.

mod canonical;
mod pairs;

pub use canonical::{CanonicalCorrelation, Regularisation, trace_correlation};
pub use pairs::{Correlation, pearson, spearman};
