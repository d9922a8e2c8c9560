//! How well classes are told: success from failure by a probe, and one rater's verdicts from another's.

mod confusion;
mod curve;
mod kappa;

pub use confusion::Confusion;
pub use curve::roc_auc;
pub use kappa::{Agreement, closest_raters, cohen_kappa};
