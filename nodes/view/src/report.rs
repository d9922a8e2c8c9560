//! How well predictions match the camera: scores, tables and a picture strip, live or from a recorded bag.
//!
//! A `Scorer` receives frames, predictions, their pictures and latent errors, and matches them by stamp. It keeps
//! sums, histograms and one rollout, so its memory is bounded. A `Report` becomes JSON, Markdown and a table for the
//! terminal (`files`), with the picture strip (`strip`).
//!
//! The decoded prediction of a time is compared with the camera's frame of that time, at the prediction's resolution.
//! The baseline ("persistence") compares the last observed frame with that same frame.
//!
//! The node [`trials`] measures how often a planner succeeds on the simulated arm.
//!
//! Not here: topics and DDS outside the nodes [`monitor`] and [`trials`]; metrics (`wm_metrics`).

mod bag;
mod figures;
mod files;
mod font;
mod frames;
mod histogram;
pub mod monitor;
pub(crate) mod pairing;
mod scorer;
mod strip;
mod table;
pub mod trials;

pub use bag::score_bag;
pub use files::write_report;
pub use table::terminal_table;

use scorer::Scorer;
