//! Figures and statistics of the paper's evaluation (appendices C and D), of plain numbers and pictures.
//!
//! Nothing here reads a file, runs a network or knows a tensor: what a network gave comes in as slices, tables and
//! pictures. All sums are f64, and every result is the same whatever the number of threads and the run: what is drawn is
//! drawn from ChaCha8 at a seed that the caller gives.
//!
//! | module | what |
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
//! Input that has no figure (nothing, too little, what never varies, NaN) gives a [`MetricError`], or `None` where only
//! a part of the result is missing; no figure is NaN.

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
