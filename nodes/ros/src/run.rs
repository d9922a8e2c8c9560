//! Runs the nodes of a process.

use crate::{
    Context, Environment, Error, Node, NodeArgs, Shutdown,
    forced_end::ForcedEnd,
    logging,
    shutdown::{GRACE, Signals},
};
use futures::{
    StreamExt as _,
    future::{FutureExt as _, LocalBoxFuture},
    stream::FuturesUnordered,
};
use std::{collections::BTreeSet, time::Duration};
use tracing::Instrument as _;

/// How long threads of `spawn_blocking` may take after that. Only the end of the process can stop a computation.
const BLOCKING_GRACE: Duration = Duration::from_millis(100);

/// Runs a node: logs, the graph, a tokio runtime for the body, and an orderly end.
///
/// The runtime is of one thread, with timers, signals and `spawn_blocking`. On SIGINT or SIGTERM every `recv` returns
/// `None` and [`Node::shutdown`] fires; the body then has 1.2 s to return before it is dropped. Publishers,
/// subscriptions and the node are removed first and the participant last, so that other participants are notified.
///
/// # Errors
/// The graph cannot be joined, the middleware has ended, or what the body returns.
pub fn run<E: From<Error>>(
    default_name: &str,
    default_namespace: &str,
    args: &NodeArgs,
    body: impl AsyncFnOnce(Node) -> Result<(), E>,
) -> Result<(), E> {
    in_graph(args, |context| {
        let node = Node::new(context, default_name, default_namespace, args)?;
        Ok(async move { body(node.clone()).await }.boxed_local())
    })
}

/// A node of a process that runs several ([`run_together`]).
pub struct Component<E> {
    default_name: &'static str,
    body: Box<dyn FnOnce(Node) -> LocalBoxFuture<'static, Result<(), E>>>,
}

impl<E> Component<E> {
    /// A node with this default name and its body.
    pub fn new(
        default_name: &'static str,
        body: impl AsyncFnOnce(Node) -> Result<(), E> + 'static,
    ) -> Self {
        let body = Box::new(move |node| async move { body(node).await }.boxed_local());
        Self { default_name, body }
    }
}

/// As [`run`], with several nodes in one process, one [`Context`] and one runtime: messages between them are passed in
/// memory. Bodies must compute in `spawn_blocking`, or the others wait.
///
/// A rule of the command line without a node's name (`-p name:=value`) applies to all nodes; a node without such a
/// parameter only warns. It ends when all bodies have returned, or with the first error.
///
/// # Errors
/// The graph cannot be joined, two nodes have the same name, the middleware has ended, or what a body returns.
pub fn run_together<E: From<Error> + 'static>(
    default_namespace: &str,
    args: &NodeArgs,
    components: Vec<Component<E>>,
) -> Result<(), E> {
    let args = args.of_several();
    in_graph(&args, |context| {
        let mut names = BTreeSet::new();
        let mut bodies = FuturesUnordered::new();
        for component in components {
            let node = Node::new(context, component.default_name, default_namespace, &args)?;
            let name = node.fully_qualified_name();
            if !names.insert(name.to_owned()) {
                return Err(Error::SameName(name.to_owned()));
            }
            let span = node.span();
            bodies.push((component.body)(node).instrument(span));
        }
        let shutdown = context.shutdown();
        Ok(async move {
            let mut result = Ok(());
            while let Some(ended) = bodies.next().await {
                if ended.is_err() && result.is_ok() {
                    result = ended;
                    shutdown.trigger();
                }
            }
            result
        }
        .boxed_local())
    })
}

/// Joins the graph, runs the future of `start`, and leaves the graph in order.
fn in_graph<'a, E: From<Error>>(
    args: &NodeArgs,
    start: impl FnOnce(&Context) -> Result<LocalBoxFuture<'a, Result<(), E>>, Error>,
) -> Result<(), E> {
    logging::init(args);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|source| Error::io("start the runtime", source))?;
    let inside = runtime.enter();
    // before any slow step
    let signals = Signals::catch()?;
    let forced_end = ForcedEnd::arm()?;
    let context = Context::new(&Environment::from_env(args)?)?;
    signals.ask(&context.shutdown());
    drop(inside);
    logging::panics::end_process(context.shutdown());
    let bodies = start(&context)?;
    forced_end.start_is_over();
    let result = runtime.block_on(until_late(bodies, context.shutdown()));
    drop(forced_end);
    let result = match result {
        Ok(()) => {
            let panicked = || logging::panics::first().map(Error::ThreadPanicked);
            context
                .failure()
                .or_else(panicked)
                .map_or(Ok(()), |error| Err(error.into()))
        }
        Err(error) => Err(error),
    };
    runtime.shutdown_timeout(BLOCKING_GRACE);
    context.close();
    logging::flush();
    result
}

/// The result of `bodies`; `None` if they have not returned in time after the shutdown.
async fn until_late<E>(
    bodies: LocalBoxFuture<'_, Result<(), E>>,
    shutdown: Shutdown,
) -> Result<(), E> {
    let late = async {
        shutdown.wait().await;
        tokio::time::sleep(GRACE).await;
    };
    tokio::select! {
        result = bodies => result,
        () = late => {
            tracing::warn!("still busy {} ms after the signal: ended anyway", GRACE.as_millis());
            Ok(())
        }
    }
}
