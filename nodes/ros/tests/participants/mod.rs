//! Participants of one process that discover each other on loopback, as two processes would, over the middleware that
//! `RMW_IMPLEMENTATION` names.

#![allow(dead_code, reason = "each test program uses a part of it")]

use crate::fresh_domain::fresh_domain;
use std::time::Duration;
use wm_ros::{Context, Environment, Middleware, Node, NodeArgs, Reach};

/// Far longer than discovery takes; only ends a hanging test.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Participants in a ROS domain of their own.
pub fn contexts<const COUNT: usize>() -> [Context; COUNT] {
    let domain = fresh_domain();
    std::array::from_fn(|_| context(domain))
}

pub fn context(domain_id: u16) -> Context {
    let reach = Reach::Localhost;
    Context::new(&Environment {
        domain_id,
        reach,
        middleware: Middleware::from_env().unwrap(),
    })
    .unwrap()
}

pub fn is_over_dds() -> bool {
    Middleware::from_env().unwrap() == Middleware::Dds
}

/// The readers of a subscription that receives latched samples and those of volatile publishers.
pub fn readers_of_both() -> usize {
    match is_over_dds() {
        true => 2,
        false => 1,
    }
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
