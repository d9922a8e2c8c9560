//! The view: a node that subscribes to the other nodes' topics and serves one live page, on loopback.
//!
//! The [`node`](NODE) receives messages and updates the `State`, which is pure. The `server` serves the page and one
//! WebSocket per client. A client's `Cursor` selects its next message. There are no queues: a client gets the newest of
//! each kind when it can receive, so a stalled client costs nothing.
//!
//! Pictures are forwarded as published, as JPEG or PNG; only raw images are encoded here. A bag can replace the live
//! topics; its pictures are read on request.
//!
//! The same port serves viewers with Foxglove's protocol.
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
mod diagnostics;
mod drop_reason;
mod error;
mod event;
mod executor;
mod foxglove;
mod inputs;
mod journal;
mod learner;
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
mod shared;
mod socket;
mod state;
mod status;
mod subprotocol;

pub use check::check;
use error::ViewError;
pub use node::NODE;

use wm_ros::NodeDefinition;

/// All nodes of this crate.
pub const NODES: &[NodeDefinition<anyhow::Error>] =
    &[report::monitor::NODE, report::trials::NODE, NODE];
