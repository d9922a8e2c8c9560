//! `wm doctor` and `wm init`: what a machine, its network, its cameras and its arm are like, whether a model fits them, and
//! what to do where it does not.
//!
//! Facts are gathered apart from what is said of them. [`Machine`] reads `/proc`, [`listen()`] hears topics for some
//! seconds, [`Parts`] runs a model once; each check is a function from facts to [`Finding`]s and is tested without any of
//! that. A [`Report`] puts findings together, as text or JSON. [`Setup`] makes a launch file and parameter files for what
//! was heard.
//!
//! Promises:
//! - It changes nothing: it subscribes, reads and computes. `wm init` makes new files only.
//! - Names and texts of peers are escaped before they are printed.
//! - Memory is bounded: a few pictures, and a limited number of topics and messages.
//!
//! Not here: the command line (`wm_cli`), what the nodes themselves find while they run (their `/diagnostics`).

mod action;
mod audit;
mod buffers;
mod camera;
mod clock;
mod comparison;
mod error;
mod fit;
mod heard;
mod listen;
mod machine;
mod memory;
mod network;
mod peers;
mod picture;
mod processor;
mod report;
mod setup;
mod timeline;
mod trial;
mod verdict;

pub use comparison::Comparison;
pub use error::DoctorError;
pub use fit::{ModelFacts, gather as examine_model};
pub use heard::{Actions, Camera, Heard, Motion, Stream};
pub use listen::listen;
pub use machine::Machine;
pub use picture::Picture;
pub use report::Report;
pub use setup::{Setup, SetupError};
pub use timeline::{Arrival, Timeline};
pub use trial::{Judging, Parts, Trial};
pub use verdict::Times;
pub use wm_audit::{Finding, Level};
