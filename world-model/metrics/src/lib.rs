//! Metrics and statistics of the paper's evaluation (appendices C and D), on numbers and pictures.
//!
//! Nothing here reads a file, runs a network or uses a tensor: outputs of networks arrive as slices, tables and
//! pictures. Sums are f64; counts are far below 2^52, so their conversion is exact. Results do not depend on the number
//! of threads; random numbers come from ChaCha8 with the caller's seed.
//!
//! | module | content |
//! | --- | --- |
//! | [`images`] | PSNR, SSIM, mean squared error |
//! | [`distributions`] | Fréchet distance (FID, FVD), maximum mean discrepancy (KID, JEDi) |
//! | [`findings`] | what an evaluation found: JSON, CSV, the HTML report, comparisons, model cards |
//! | [`correlation`] | Pearson, Spearman, canonical correlations |
//! | [`classification`] | balanced accuracy, ROC AUC, Cohen's kappa |
//! | [`ranking`] | ranks, Borda, consensus of raters |
//! | [`statistics`] | bootstrap, sign-flip test, Wilson's interval, standard errors |
//! | [`motion`] | optical flow, dynamic degree, t-LPIPS, point tracks, consistency of features |
//! | [`depth`] | AbsRel of aligned depth |
//!
//! ```
//! use wm_metrics::statistics::{Bootstrap, bootstrap_mean};
//!
//! // 39 successes of 160 trials.
//! let trials: Vec<f64> = (0..160).map(|trial| f64::from(trial < 39)).collect();
//! let rate = bootstrap_mean(&trials, &Bootstrap::default())?;
//! assert!((rate.value - 0.244).abs() < 1e-3);
//! assert!(rate.interval.low < 0.19 && rate.interval.high > 0.30);
//! # Ok::<(), wm_metrics::MetricError>(())
//! ```
//!
//! Input without a defined result (empty, too few, constant, NaN) gives a [`MetricError`], or `None` if only a part of
//! the result is undefined. No result is NaN.

pub mod classification;
pub mod correlation;
pub mod depth;
pub mod distributions;
mod error;
pub mod findings;
pub mod images;
pub mod motion;
pub mod ranking;
pub mod statistics;
mod table;

pub use error::MetricError;
pub use table::Table;
