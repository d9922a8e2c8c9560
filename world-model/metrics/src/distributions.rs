//! Distances between two sets of feature vectors, for example a network's features of generated and of real frames.
//!
//! The network is the caller's: with Inception's 2048 features per frame [`frechet_distance`] is FID, with features of a
//! video network per clip it is FVD; with V-JEPA's per clip [`maximum_mean_discrepancy`] is JEDi, with Inception's KID.

mod discrepancy;
mod frechet;
mod moments;

pub use discrepancy::{Estimator, PolynomialKernel, jepa_similarity, maximum_mean_discrepancy};
pub use frechet::frechet_distance;
pub use moments::Moments;
