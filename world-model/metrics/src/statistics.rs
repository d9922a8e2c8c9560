//! Uncertainty of metrics: intervals and tests of differences (the paper, appendix D.3).

mod bootstrap;
mod clustered;
mod interval;
mod sign_flip;

pub use bootstrap::{
    Bootstrap, Estimate, bootstrap, bootstrap_mean, bootstrap_paired_difference, replicates,
};
pub use clustered::{bootstrap_clustered, bootstrap_clustered_mean};
pub(crate) use interval::Z95;
pub use interval::{Interval, standard_error, standard_error_of_share, wilson};
pub use sign_flip::{Method, SignFlip, SignFlipTest, sign_flip_test};
