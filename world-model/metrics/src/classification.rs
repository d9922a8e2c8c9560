//! Metrics of classification: success against failure, and one rater against another.

mod confusion;
mod curve;
mod kappa;

pub use confusion::Confusion;
pub use curve::roc_auc;
pub use kappa::{Agreement, closest_raters, cohen_kappa};
