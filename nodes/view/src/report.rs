//! How well the predictions matched the camera: scores, tables and a picture strip, live or from a recorded bag.
//!
//! A [`Scorer`] takes frames, predictions, their pictures and errors as they come, matches them by stamp, and keeps
//! sums, histograms and one rollout to show: its memory does not grow with time. [`Report`] is what comes out, as
//! JSON, Markdown and a table for the terminal ([`files`]), with the picture strip ([`strip`]).
//!
//! What is compared: the decoded prediction of a moment with the camera's frame of that moment, at the prediction's
//! resolution; and, as baseline, the last observed frame, repeated ("persistence") with that same frame.
//!
//! How often a planner succeeds on the simulated arm is another question, which the node [`trials`] answers.
//!
//! Not here: topics and DDS (the nodes [`monitor`] and [`trials`] alone), metrics themselves (`wm_metrics`).

mod bag;
pub mod figures;
pub mod files;
mod font;
mod frames;
mod histogram;
pub mod monitor;
pub mod pairing;
pub mod scorer;
pub mod strip;
pub mod table;
pub mod trials;

pub use bag::score_bag;
pub use figures::Report;
pub use scorer::Scorer;
