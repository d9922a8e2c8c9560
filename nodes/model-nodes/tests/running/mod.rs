//! Nodes in participants of their own, on loopback.

use std::{thread::JoinHandle, time::Duration};

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

/// Runs nodes with their parameters, each in a participant of its own, and a scenario that uses another one. Then ends the
/// nodes in their order, and returns the scenario's result.
pub fn with_nodes<T>(
    context: impl Fn() -> Context,
    nodes: &[(&'static NodeDefinition<anyhow::Error>, String)],
    scenario: impl AsyncFnOnce(&Context) -> T,
) -> T {
    let mut running = Vec::new();
    for (definition, parameters) in nodes {
        let context = context();
        let thread = start(&context, definition, parameters);
        running.push((context, thread));
    }
    let here = context();
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
#[allow(dead_code, reason = "not every test waits for single messages")]
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
