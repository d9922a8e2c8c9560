//! `wm doctor` and `wm init`: check machine, network, cameras, arm and model, and suggest fixes.
//!
//! Facts and findings are separate. [`Machine`] reads `/proc`, [`listen()`] subscribes to topics for some seconds,
//! [`Parts`] runs a model once. Each check is a pure function from facts to `Finding`s. A [`Report`] combines
//! findings, as text or JSON. [`Setup`] generates a launch file and parameter files.
//!
//! Promises:
//! - It changes nothing: it subscribes, reads and computes. `wm init` only creates files.
//! - Names and texts of peers are escaped before they are printed.
//! - Memory is bounded: a few pictures, and a limited number of topics and messages.
//!
//! Not here: the command line (`wm_cli`), faults that nodes find while running (their `/diagnostics`).

mod action;
mod audit;
mod buffers;
mod camera;
mod clock;
mod comparison;
mod control_group;
mod error;
mod fit;
mod listen;
mod machine;
mod memory;
mod network;
mod peers;
mod picture;
mod processor;
mod report;
mod setup;
mod survey;
mod system_file;
mod timeline;
mod trial;
mod verdict;

pub use error::DoctorError;
pub use fit::{ModelFacts, gather as examine_model};
pub use listen::listen;
pub use machine::Machine;
pub use report::Report;
pub use setup::{Setup, SetupError};
pub use survey::Survey;
pub use trial::Parts;
pub use wm_audit::Level;

use picture::Picture;
use survey::{Actions, Camera, Motion, Stream};
use timeline::{Arrival, Timeline};
use trial::Trial;
use verdict::Times;
use wm_audit::Finding;
