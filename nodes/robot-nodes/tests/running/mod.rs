//! Nodes that run in threads of their own.

use crate::fresh_domain::fresh_domain;
use std::{thread::JoinHandle, time::Duration};

use wm_ros::{Context, Environment, Middleware, Node, NodeArgs, NodeDefinition, Reach};

/// Far longer than any step of a test: it only ends a test that hangs.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// A participant on loopback.
pub fn context(domain_id: u16) -> Context {
    let reach = Reach::Localhost;
    Context::new(&Environment {
        domain_id,
        reach,
        middleware: Middleware::from_env().unwrap(),
    })
    .unwrap()
}

/// A node of the test itself.
pub fn node(context: &Context, name: &str, words: &str) -> Node {
    let args = NodeArgs::parse(words.split_whitespace()).unwrap();
    Node::new(context, name, wm_ros::NAMESPACE, &args).unwrap()
}

/// Runs a node until its context ends.
pub fn start(
    context: &Context,
    definition: &'static NodeDefinition<anyhow::Error>,
    parameters: &str,
) -> JoinHandle<anyhow::Result<()>> {
    let context = context.clone();
    let words = format!("--ros-args {parameters}");
    std::thread::spawn(move || {
        let args = NodeArgs::parse(words.split_whitespace()).unwrap();
        let node = Node::new(&context, definition.name, wm_ros::NAMESPACE, &args)?;
        tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?
            .block_on((definition.body)(node))
    })
}

/// Runs nodes with their parameters, each in a participant of its own, and a scenario that uses another one. Then ends the
/// nodes in their order, and returns the scenario's result.
pub async fn with_nodes<T>(
    nodes: &[(&'static NodeDefinition<anyhow::Error>, &str)],
    scenario: impl AsyncFnOnce(&Context) -> T,
) -> T {
    let domain = fresh_domain();
    let mut running = Vec::new();
    for (definition, parameters) in nodes {
        let context = context(domain);
        let thread = start(&context, definition, parameters);
        running.push((context, thread));
    }
    let here = context(domain);
    let result = in_time(scenario(&here)).await;
    for (context, thread) in running {
        context.shutdown().trigger();
        thread.join().unwrap().unwrap();
        context.close();
    }
    here.close();
    result
}

/// Fails the test if the scenario takes longer than [`PATIENCE`].
#[track_caller]
pub fn in_time<T>(scenario: impl Future<Output = T>) -> impl Future<Output = T> {
    let caller = std::panic::Location::caller();
    async move {
        let ended = tokio::time::timeout(PATIENCE, scenario).await;
        ended.unwrap_or_else(|_| panic!("{caller}: an expected message did not arrive"))
    }
}

/// The error of a node that refuses its parameters.
pub fn refusal(definition: &'static NodeDefinition<anyhow::Error>, parameters: &str) -> String {
    let context = context(fresh_domain());
    let result = start(&context, definition, parameters).join().unwrap();
    context.close();
    format!("{:#}", result.unwrap_err())
}
