//! Nodes in participants of their own, on loopback.

pub mod model;

use std::{
    sync::{PoisonError, RwLock},
    thread::JoinHandle,
    time::Duration,
};

use crate::fresh_domain::fresh_domain;
use wm_msgs::Message;
use wm_ros::{
    Context, Environment, Middleware, Node, NodeArgs, NodeDefinition, Reach, Subscription,
};

/// Far longer than any step of a test: it only ends a test that hangs.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A participant of ROS domain `domain_id`.
pub fn context(domain_id: u16) -> Context {
    Context::new(&Environment {
        domain_id,
        reach: Reach::Localhost,
        middleware: Middleware::from_env().unwrap(),
    })
    .unwrap()
}

static PROCESSORS: RwLock<()> = RwLock::new(());

/// No test computes while the guard lives: messages that came late would be lost.
pub fn quiet() -> impl Drop {
    PROCESSORS.write().unwrap_or_else(PoisonError::into_inner)
}

/// No test of messages runs while the guard lives.
pub fn computing() -> impl Drop {
    PROCESSORS.read().unwrap_or_else(PoisonError::into_inner)
}

/// Runs nodes with their parameters, each in a participant of its own, and a scenario that uses another one. Then ends the
/// nodes in their order, and returns the scenario's result.
pub fn with_nodes<T>(
    nodes: &[(&'static NodeDefinition<anyhow::Error>, String)],
    scenario: impl AsyncFnOnce(&Context) -> T,
) -> T {
    let _quiet = quiet();
    let domain = fresh_domain();
    let mut running = Vec::new();
    for (definition, parameters) in nodes {
        let context = context(domain);
        let thread = start(&context, definition, parameters);
        running.push((context, thread));
    }
    let here = context(domain);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let result = runtime.block_on(scenario(&here));
    drop(runtime);
    here.close();
    for (context, thread) in running {
        context.shutdown().trigger();
        thread.join().unwrap().unwrap();
        context.close();
    }
    result
}

/// Runs a node in a thread of its own until its context ends.
fn start(
    context: &Context,
    definition: &'static NodeDefinition<anyhow::Error>,
    parameters: &str,
) -> JoinHandle<anyhow::Result<()>> {
    let words = format!("--ros-args {parameters}");
    let args = NodeArgs::parse(words.split_whitespace()).unwrap();
    let context = context.clone();
    std::thread::spawn(move || {
        let name = definition.name;
        let node = Node::new(&context, name, wm_ros::NAMESPACE, &args)?;
        tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?
            .block_on((definition.body)(node))
            .inspect_err(|error| eprintln!("{name}: {error:#}"))
    })
}

/// The next message.
pub async fn soon<M: Message>(what: &str, subscription: &mut Subscription<M>) -> M {
    let received = tokio::time::timeout(PATIENCE, subscription.recv()).await;
    received
        .unwrap_or_else(|_| {
            panic!(
                "{what}: nothing on {} for {PATIENCE:?}",
                subscription.topic()
            )
        })
        .unwrap()
        .message
}
