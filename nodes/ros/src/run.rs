//! The frame of a node's process.

use crate::{Context, Environment, Error, Node, NodeArgs, logging};
use std::time::Duration;

/// How long a body may take to return after SIGINT or SIGTERM, so that the process is gone within 2 s.
const GRACE: Duration = Duration::from_millis(1200);
/// How long threads of `spawn_blocking` may take after that. A computation cannot be stopped from outside; the
/// process's end does it.
const BLOCKING_GRACE: Duration = Duration::from_millis(100);

/// Runs a node: logs, the graph, a tokio runtime for the body, and an orderly end.
///
/// The runtime is of one thread, with timers, signals and `spawn_blocking`. On SIGINT or SIGTERM every `recv`
/// gives `None` and [`Node::shutdown`] fires; the body then has 1.2 s to return before it is dropped. Publishers,
/// subscriptions and the node go first and the participant last, so that the rest of the graph hears of it.
///
/// # Errors
/// The graph cannot be joined, or what the body returns.
pub fn run<E: From<Error>>(
    default_name: &str,
    default_namespace: &str,
    args: &NodeArgs,
    body: impl AsyncFnOnce(Node) -> Result<(), E>,
) -> Result<(), E> {
    logging::init(args);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|source| Error::io("start the runtime", source))?;
    let context = Context::new(&Environment::from_env(args)?)?;
    context.listen_for_signals()?;
    let node = Node::new(&context, default_name, default_namespace, args)?;
    let shutdown = context.shutdown();
    let result = runtime.block_on(async {
        let late = async {
            shutdown.wait().await;
            tokio::time::sleep(GRACE).await;
        };
        tokio::select! {
            result = body(node.clone()) => result,
            () = late => {
                tracing::warn!("still busy {} ms after the signal: stopped", GRACE.as_millis());
                Ok(())
            }
        }
    });
    runtime.shutdown_timeout(BLOCKING_GRACE);
    drop(node);
    context.close();
    result
}
