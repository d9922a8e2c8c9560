//! Participants of one process that see each other over DDS on loopback, as two processes would.

#![allow(dead_code, reason = "each test program uses a part of it")]

use std::time::Duration;
use wm_ros::{Context, Environment, Node, NodeArgs, Reach};

/// Far longer than discovery takes; only ends a hanging test.
pub const PATIENCE: Duration = Duration::from_secs(60);

pub fn context(domain_id: u16) -> Context {
    let reach = Reach::Localhost;
    Context::new(&Environment { domain_id, reach }).unwrap()
}

/// A node with the arguments of `line`, separated by spaces.
pub fn node(context: &Context, name: &str, line: &str) -> Node {
    let args = NodeArgs::parse(line.split_whitespace()).unwrap();
    Node::new(context, name, "/wm", &args).unwrap()
}

pub async fn soon<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, future)
        .await
        .unwrap_or_else(|_| panic!("{what} took more than {PATIENCE:?}"))
}
