//! The view: a node that subscribes to what the others publish and serves one live page, on loopback.
//!
//! What goes where: the [`node`](NODE) hears messages and tells the `State` of them, which is pure; the `server` serves the
//! page and one WebSocket per client; a client's `Cursor` says what of the state it is to be sent next. Nothing is queued
//! for a client: it is sent the newest of each kind when it can take it, so a client that stands still costs nothing.
//!
//! Pictures are forwarded as the JPEG or PNG that was published; only an image topic that has nothing but raw images is
//! encoded here. The same state is fed from a bag, whose pictures are read when they are looked at.
//!
//! Beside its page it serves viewers that speak Foxglove's protocol, on the same port.
//!
//! The module [`report`] scores predictions against what happened, writes the report, and has the nodes monitor and trials.
//!
//! Not here: the figures themselves (`wm_metrics`), DDS (`wm_ros`).

mod access;
mod album;
mod bag;
mod check;
mod clip;
mod command;
mod control;
mod conversion;
mod cursor;
mod error;
mod event;
mod foxglove;
mod inputs;
mod journal;
mod listener;
mod node;
mod page;
mod parameters;
mod picture;
mod picture_subscription;
mod rate;
pub mod report;
mod scene;
mod server;
mod socket;
mod state;
mod status;
mod subprotocol;

pub use check::check;
pub use error::ViewError;
pub use node::NODE;

use wm_ros::NodeDefinition;

/// All nodes of this crate.
pub const NODES: &[NodeDefinition<anyhow::Error>] =
    &[report::monitor::NODE, report::trials::NODE, NODE];
