//! The trait of a node, and the code that runs it: arguments, parameters, topics, lifecycle and an orderly end.

use crate::{
    ChosenTopics, EndpointSet, Error, Lifecycle, Managed, NAMESPACE, Node, NodeArgs,
    NodeDefinition, ParameterSet,
};
use futures::future::{FutureExt as _, LocalBoxFuture};
use std::{fmt::Display, process::ExitCode, sync::Arc};

/// A node. The type itself is the node's state while it works.
///
/// The runtime calls [`check`](Self::check), [`load`](Self::load), [`activate`](Self::activate) and [`run`](Self::run)
/// in this order. Topics and services exist after `load`. The lifecycle of a managed node
/// ([`IS_MANAGED`](Self::IS_MANAGED)) calls `load` at each configuration, and `activate` and `run` at each activation.
///
/// A whole node in one file:
///
/// ```
/// use std::sync::Arc;
/// use wm_msgs::std_msgs::String as Text;
/// use wm_msgs::std_srvs::{Outcome, Trigger};
/// use wm_ros::{Error, Node, NodeDefinition, NodeProgram, Publisher, Requests, Service, Setup, Subscription, answer};
///
/// wm_ros::parameters! {
///     /// Its parameters.
///     struct Parameters {
///         /// Text that follows each shout.
///         suffix: String = "!";
///     }
/// }
///
/// wm_ros::endpoints! {
///     /// Its topics and services.
///     struct Endpoints {
///         /// Texts to shout.
///         texts: Subscription<Text> = "text";
///         /// The texts in capitals.
///         shouts: Publisher<Text> = "shout";
///         /// Requests of clients.
///         requests: Requests<Request>;
///     }
/// }
///
/// wm_ros::endpoints! {
///     /// Requests of clients.
///     enum Request {
///         /// Reports the number of shouts.
///         Count(Service<Trigger>) = "~/count";
///     }
/// }
///
/// struct Shouter {
///     count: u64,
/// }
///
/// /// The pure step.
/// fn shout(text: &str, suffix: &str) -> String {
///     text.to_uppercase() + suffix
/// }
///
/// impl NodeProgram for Shouter {
///     const NAME: &'static str = "shouter";
///     const ABOUT: &'static str = "Publishes texts in capitals.";
///     type Parameters = Parameters;
///     type Endpoints = Endpoints;
///     type Resources = ();
///     type Error = Error;
///
///     async fn load(_: &Node, _: &Arc<Parameters>) -> Result<(), Error> {
///         Ok(())
///     }
///
///     fn activate(_: &Setup<Self>) -> Result<Self, Error> {
///         Ok(Self { count: 0 })
///     }
///
///     async fn run(&mut self, at: &mut Setup<Self>) -> Result<(), Error> {
///         let Endpoints { texts, shouts, requests } = &mut at.endpoints;
///         loop {
///             tokio::select! {
///                 received = texts.recv() => {
///                     let Some(received) = received else { return Ok(()) };
///                     let data = shout(&received.message.data, &at.parameters.suffix);
///                     shouts.publish(&Text { data })?;
///                     self.count += 1;
///                 }
///                 Some(request) = requests.next_request() => match request {
///                     Request::Count(call) => {
///                         let message = format!("{} shouts", self.count);
///                         answer(call, &Outcome { success: true, message });
///                     }
///                 }
///             }
///         }
///     }
/// }
///
/// /// For the registry of its crate, `NODES` in `lib.rs`.
/// pub const NODE: NodeDefinition<Error> = NodeDefinition::of::<Shouter>();
///
/// assert_eq!(shout("hello", "!"), "HELLO!");
/// assert!(NODE.help().contains("~/count  std_srvs/srv/Trigger"));
/// assert!(NODE.params_file().contains("suffix: '!'"));
/// ```
pub trait NodeProgram: Sized + 'static {
    /// The node's default name, and its command's.
    const NAME: &'static str;
    /// Its purpose, in one line.
    const ABOUT: &'static str;
    /// Whether it has a [`Lifecycle`].
    const IS_MANAGED: bool = false;
    /// Whether it is the only node of its process: it has an end of its own ([`finish`](Self::finish)).
    const RUNS_ALONE: bool = false;
    /// Topics that it chooses at run time, beyond its endpoints: a recorder subscribes to any topic, a player publishes
    /// the topics of its bag.
    const CHOSEN_TOPICS: ChosenTopics = ChosenTopics::None;
    /// Whether all endpoints exist before it runs. Only then is a `qos_overrides` parameter of another topic an error.
    const HAS_FIXED_ENDPOINTS: bool = true;
    /// Its parameters, without those that every node has. Made by [`parameters!`](crate::parameters).
    type Parameters: ParameterSet + 'static;
    /// Its topics, services and actions. Made by [`endpoints!`](crate::endpoints).
    type Endpoints: EndpointSet + 'static;
    /// Resources loaded before its topics exist: a model, a bag, a simulator. `()` for most nodes.
    type Resources: 'static;
    /// An error that ends it.
    type Error: From<Error> + Display + 'static;

    /// Refuses inconsistent parameters, before anything else happens.
    ///
    /// # Errors
    /// Names them.
    fn check(_parameters: &Self::Parameters) -> Result<(), Self::Error> {
        Ok(())
    }

    /// Loads the resources. Blocking work belongs into `spawn_blocking`.
    ///
    /// # Errors
    /// Names the missing or invalid resource.
    fn load(
        node: &Node,
        parameters: &Arc<Self::Parameters>,
    ) -> impl Future<Output = Result<Self::Resources, Self::Error>>;

    /// Starts with an empty history.
    ///
    /// # Errors
    /// Any error. A managed node then stays inactive.
    fn activate(at: &Setup<Self>) -> Result<Self, Self::Error>;

    /// Works until the shutdown, at which every `recv` returns `None`, or until its own end. Deactivating a managed
    /// node drops this future at an `await`.
    ///
    /// # Errors
    /// An error that ends the node. Bad input is not such an error.
    fn run(&mut self, at: &mut Setup<Self>) -> impl Future<Output = Result<(), Self::Error>>;

    /// The end of a node that [runs alone](Self::RUNS_ALONE), after it has left the graph: closes a bag, writes a report.
    /// It is also called if `run` failed, or did not return in time after a signal.
    ///
    /// # Errors
    /// The error of `run`, or its own.
    fn finish(self, ended: Result<(), Self::Error>) -> Result<ExitCode, Self::Error> {
        ended.map(|()| ExitCode::SUCCESS)
    }
}

/// The node, its parameters, resources and endpoints.
pub struct Setup<N: NodeProgram> {
    /// The node; endpoints made by this handle are silent while a managed node is inactive.
    pub node: Node,
    /// Its parameters.
    pub parameters: Arc<N::Parameters>,
    /// The result of `load`.
    pub resources: N::Resources,
    /// Its topics, services and actions.
    pub endpoints: N::Endpoints,
}

impl<E: From<Error> + 'static> NodeDefinition<E> {
    /// The definition of a node, for the registry of its crate.
    #[must_use]
    pub const fn of<N: NodeProgram<Error = E>>() -> Self {
        Self {
            name: N::NAME,
            about: N::ABOUT,
            parameters: N::Parameters::specs,
            endpoints: N::Endpoints::specs,
            chosen_topics: N::CHOSEN_TOPICS,
            is_managed: N::IS_MANAGED,
            runs_alone: N::RUNS_ALONE,
            run: run::<N>,
            body: body::<N>,
        }
    }
}

/// The node as a process.
fn run<N: NodeProgram>(args: &NodeArgs) -> Result<ExitCode, N::Error> {
    args.expect_no_rest().map_err(Error::from)?;
    if !N::RUNS_ALONE {
        return crate::run(N::NAME, NAMESPACE, args, body::<N>).map(|()| ExitCode::SUCCESS);
    }
    let mut program: Option<N> = None;
    let task = async |node: Node| work(node, &mut program).await;
    let ended = crate::run(N::NAME, NAMESPACE, args, task);
    match program {
        Some(program) => program.finish(ended),
        None => ended.map(|()| ExitCode::SUCCESS),
    }
}

/// The node in a process that may run other nodes too.
fn body<N: NodeProgram>(node: Node) -> LocalBoxFuture<'static, Result<(), N::Error>> {
    async move { work::<N>(node, &mut None).await }.boxed_local()
}

/// The node in the graph. An unmanaged one is left in `program` while it works and afterwards.
async fn work<N: NodeProgram>(node: Node, program: &mut Option<N>) -> Result<(), N::Error> {
    let lifecycle = match N::IS_MANAGED {
        true => Some(Lifecycle::new(&node)?),
        false => None,
    };
    let parameters = Arc::new(N::Parameters::declare(&node)?);
    node.seal_parameters()?;
    N::check(&parameters)?;
    let frame = Frame::<N> { parameters };
    if let Some(lifecycle) = lifecycle {
        return lifecycle.run(frame).await;
    }
    let mut setup = frame.configure(&node).await?;
    if N::HAS_FIXED_ENDPOINTS {
        node.seal_endpoints()?;
    }
    let program = program.insert(N::activate(&setup)?);
    program.run(&mut setup).await
}

/// A node before it is configured.
struct Frame<N: NodeProgram> {
    parameters: Arc<N::Parameters>,
}

impl<N: NodeProgram> Managed for Frame<N> {
    type Configured = Setup<N>;
    type Active = N;
    type Error = N::Error;

    async fn configure(&self, node: &Node) -> Result<Setup<N>, N::Error> {
        Ok(Setup {
            node: node.clone(),
            parameters: Arc::clone(&self.parameters),
            resources: N::load(node, &self.parameters).await?,
            endpoints: N::Endpoints::make(node)?,
        })
    }

    fn activate(&self, setup: &Setup<N>) -> Result<N, N::Error> {
        N::activate(setup)
    }

    async fn run(&self, setup: &mut Setup<N>, program: &mut N) -> Result<(), N::Error> {
        program.run(setup).await
    }
}
