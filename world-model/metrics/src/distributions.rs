//! Distances between two sets of feature vectors, for example of generated and real frames.
//!
//! The caller chooses the network. [`frechet_distance`] is FID with Inception's 2048 features per frame, and FVD with a
//! video network's features per clip. [`maximum_mean_discrepancy`] is JEDi with V-JEPA's features per clip, and KID
//! with Inception's.

mod discrepancy;
mod frechet;
mod moments;

pub use discrepancy::{Estimator, PolynomialKernel, jepa_similarity, maximum_mean_discrepancy};
pub use frechet::frechet_distance;
pub use moments::Moments;
