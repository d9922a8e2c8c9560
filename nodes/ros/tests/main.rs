//! Nodes, services, actions and the graph, over the middleware that `RMW_IMPLEMENTATION` names.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail the test"
)]

mod actions;
mod any_publisher;
#[path = "../../../tests/fresh_domain.rs"]
mod fresh_domain;
mod graph;
mod large_messages;
mod lifecycle;
mod output;
mod participants;
mod program;
mod shared_messages;
