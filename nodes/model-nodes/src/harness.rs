//! What all nodes that compute with the world model have in common: the lifecycle, the parameter `model`, loading the
//! model off the message loop, and the endpoints, which exist from configure to cleanup. A node adds a [`ModelNode`].
//!
//! ```no_run
//! use wm_model_nodes::harness::{self, Configured, ModelNode};
//! use wm_msgs::{std_msgs::String as Text, wm_msgs::Latent};
//! use wm_ros::{NodeDefinition, Publisher, Qos, Subscription};
//! use wm_zoo::ModelFolder;
//!
//! wm_ros::parameters! {
//!     /// Its parameters.
//!     struct Parameters {
//!         /// Latents per message.
//!         every: usize = 10, in 1..=1000;
//!     }
//! }
//!
//! wm_ros::endpoints! {
//!     /// Its topics.
//!     struct Endpoints {
//!         /// The camera's latents.
//!         latents: Subscription<Latent> = "latent", qos(Qos::sensor_data());
//!         /// How many there were.
//!         counts: Publisher<Text> = "latent_count";
//!     }
//! }
//!
//! struct Counter {
//!     count: usize,
//! }
//!
//! impl ModelNode for Counter {
//!     const NAME: &'static str = "counter";
//!     const ABOUT: &'static str = "Counts latents.";
//!     type Parameters = Parameters;
//!     type Endpoints = Endpoints;
//!     type Model = ();
//!
//!     fn load(_: ModelFolder, _: &Parameters) -> anyhow::Result<()> {
//!         Ok(())
//!     }
//!
//!     fn activate(_: &Configured<Self>) -> anyhow::Result<Self> {
//!         Ok(Self { count: 0 })
//!     }
//!
//!     async fn run(&mut self, at: &mut Configured<Self>) -> anyhow::Result<()> {
//!         while at.endpoints.latents.recv().await.is_some() {
//!             self.count += 1;
//!             if self.count % at.parameters.every == 0 {
//!                 let data = self.count.to_string();
//!                 at.endpoints.counts.publish(&Text { data })?;
//!             }
//!         }
//!         Ok(())
//!     }
//! }
//!
//! /// For the registry, `NODES` in `lib.rs`.
//! pub const NODE: NodeDefinition<anyhow::Error> = harness::definition::<Counter>();
//! ```

mod follower;
mod goals;

pub(crate) use follower::follows;
pub use follower::{Event, Follower, Follows, Inputs, Told};
pub use goals::{GoalInputs, Goals};

use std::{process::ExitCode, sync::Arc};

use anyhow::{Context as _, Result};
use wm_model::{Compute, trained_folder::EMBEDDED};
use wm_ros::{
    Component, EndpointSet, Lifecycle, Managed, NAMESPACE, Node, NodeArgs, NodeDefinition,
    ParameterSet, ParameterSpec,
};
use wm_zoo::ModelFolder;

/// A node that computes with the world model. The type itself is what the node holds while it is active.
pub trait ModelNode: Sized + 'static {
    /// The node's default name, and its command's.
    const NAME: &'static str;
    /// What it does, in one line.
    const ABOUT: &'static str;
    /// Its parameters, without `model`, `device`, `cuda_graphs` and those that every node has. Made by [`wm_ros::parameters!`].
    type Parameters: ParameterSet + Send + Sync + 'static;
    /// Its topics and services. Made by [`wm_ros::endpoints!`].
    type Endpoints: EndpointSet;
    /// What it loads when it is configured, and keeps until cleanup.
    type Model: Send + 'static;

    /// Refuses inconsistent parameters, before anything else is done.
    ///
    /// # Errors
    /// Names them.
    fn check(_parameters: &Self::Parameters) -> Result<()> {
        Ok(())
    }

    /// Loads the parts of the model that it needs. Runs on a separate thread.
    ///
    /// # Errors
    /// Names what is missing or wrong.
    fn load(model: ModelFolder, parameters: &Self::Parameters) -> Result<Self::Model>;

    /// Starts with an empty history.
    ///
    /// # Errors
    /// Whatever prevents that; the node stays inactive.
    fn activate(at: &Configured<Self>) -> Result<Self>;

    /// Runs until the shutdown, at which every `recv` returns `None`. Deactivating drops this future where it waits.
    ///
    /// # Errors
    /// An error after which the node cannot continue, and with which it ends. Bad input is not such an error.
    fn run(&mut self, at: &mut Configured<Self>) -> impl Future<Output = Result<()>>;
}

/// What a configured node has.
pub struct Configured<N: ModelNode> {
    /// The node; endpoints that are made by this handle are silent while it is inactive.
    pub node: Node,
    /// Its parameters.
    pub parameters: Arc<N::Parameters>,
    /// What it has loaded.
    pub model: N::Model,
    /// Its topics and services.
    pub endpoints: N::Endpoints,
}

wm_ros::parameters! {
    /// The parameters that every node of this kind has.
    struct Common {
        /// World model: tiny (embedded), or the path of a model folder.
        model: String = EMBEDDED;
        /// What computes the model: cpu, or an NVIDIA GPU, cuda (the first one) or cuda:N. A GPU needs a program built with
        /// the feature cuda.
        device: String = "cpu";
        /// Whether a GPU records the launches of an Euler step and repeats them as one (CUDA graphs). Of no effect on the
        /// CPU, in the encoder and in the decoder.
        cuda_graphs: bool = false;
    }
}

/// The node, for the registry.
#[must_use]
pub const fn definition<N: ModelNode>() -> NodeDefinition<anyhow::Error> {
    NodeDefinition {
        name: N::NAME,
        about: N::ABOUT,
        parameters: specs::<N>,
        endpoints: N::Endpoints::specs,
        is_managed: true,
        run: run::<N>,
        component: Some(component::<N>),
    }
}

fn specs<N: ModelNode>() -> Vec<ParameterSpec> {
    let mut specs = Common::specs();
    specs.extend(N::Parameters::specs());
    specs
}

fn run<N: ModelNode>(args: &NodeArgs) -> Result<ExitCode> {
    args.expect_no_rest()?;
    wm_ros::run(N::NAME, NAMESPACE, args, body::<N>).map(|()| ExitCode::SUCCESS)
}

fn component<N: ModelNode>() -> Component<anyhow::Error> {
    Component::new(N::NAME, body::<N>)
}

/// The node itself, in a process that may run other nodes too.
///
/// # Errors
/// Parameters are invalid, weights cannot be loaded, or the graph fails.
pub async fn body<N: ModelNode>(node: Node) -> Result<()> {
    let lifecycle = Lifecycle::new(&node)?;
    let common = Common::declare(&node)?;
    let parameters = Arc::new(N::Parameters::declare(&node)?);
    node.seal_parameters()?;
    N::check(&parameters)?;
    let compute: Compute = common.device.parse()?;
    let harness = Harness::<N> {
        model: common.model,
        compute: compute.recording(common.cuda_graphs),
        parameters,
    };
    lifecycle.run(harness).await
}

struct Harness<N: ModelNode> {
    /// The parameter `model`.
    model: String,
    /// The parameters `device` and `cuda_graphs`.
    compute: Compute,
    parameters: Arc<N::Parameters>,
}

impl<N: ModelNode> Managed for Harness<N> {
    type Configured = Configured<N>;
    type Active = N;
    type Error = anyhow::Error;

    async fn configure(&self, node: &Node) -> Result<Configured<N>> {
        let (name, parameters) = (self.model.clone(), Arc::clone(&self.parameters));
        let (compute, span) = (self.compute.clone(), tracing::Span::current());
        let load = move || {
            let load = || {
                let model = ModelFolder::open(&name)?.on(compute);
                for mark in model.unfinished()? {
                    tracing::warn!("{name}: the training of its {} is {mark}", mark.part);
                }
                N::load(model, &parameters)
            };
            span.in_scope(load)
                .with_context(|| format!("parameter model is \"{name}\""))
        };
        Ok(Configured {
            node: node.clone(),
            parameters: Arc::clone(&self.parameters),
            model: tokio::task::spawn_blocking(load).await??,
            endpoints: N::Endpoints::make(node)?,
        })
    }

    fn activate(&self, at: &Configured<N>) -> Result<N> {
        N::activate(at)
    }

    async fn run(&self, at: &mut Configured<N>, active: &mut N) -> Result<()> {
        active.run(at).await
    }
}
