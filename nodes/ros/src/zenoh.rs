//! Zenoh as the middleware, in the wire format of `rmw_zenoh_cpp`: data keys, liveliness tokens as the graph,
//! attachments, and queries as services. Also the Zenoh sessions of the suite's other programs ([`NetworkArguments`],
//! [`open`]).
//!
//! The format is that of <https://github.com/ros2/rmw_zenoh> (`docs/design.md`), stable since ROS 2 Kilted.

mod apart;
mod attachment;
mod backend;
mod calls;
mod graph;
mod key;
mod network;
mod qos_text;
mod reader;
mod session;
mod shared;
mod tls;
mod token;
mod writer;

pub(crate) use backend::Zenoh;
pub use network::{Mode, NetworkArguments, open};
pub use session::{router_config, session_config};
