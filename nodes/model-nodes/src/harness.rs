//! Nodes that compute with the world model. [`ModelNode`] gives them the parameters `model`, `device` and
//! `cuda_graphs`, and loads the model off the message loop:
//!
//! ```no_run
//! use wm_model_nodes::harness::{self, ModelNode, ModelSetup};
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
//!     fn activate(_: &ModelSetup<Self>) -> anyhow::Result<Self> {
//!         Ok(Self { count: 0 })
//!     }
//!
//!     async fn run(&mut self, at: &mut ModelSetup<Self>) -> anyhow::Result<()> {
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

mod changes;
mod follower;
mod goals;
mod handover;
mod model_node;

pub use changes::WithChoice;
pub(crate) use follower::follows;
pub use follower::{Event, Follower, Follows, Inputs, Outcome};
pub(crate) use goals::OTHER_SPACE;
pub use goals::{GoalInputs, Goals};
pub use handover::Handover;
pub(crate) use handover::{KeptMessage, is_of};
pub use model_node::{ModelNode, ModelProgram, ModelSetup, definition};

use std::{ops::Deref, sync::Arc};

use anyhow::{Context as _, Result};
use wm_model::{Compute, trained_folder::EMBEDDED};
use wm_ros::{Error, Node, ParameterSet, ParameterSpec};
use wm_zoo::ModelFolder;

wm_ros::parameters! {
    /// The parameters of every node of this kind.
    struct Common {
        /// World model: tiny (embedded), or the path of a model folder.
        model: String = EMBEDDED;
        /// What computes the model: cpu, or an NVIDIA GPU, cuda (the first one) or cuda:N. A GPU needs a program built
        /// with the feature cuda.
        device: String = "cpu";
        /// Whether a GPU records the launches of an Euler step and repeats them as one (CUDA graphs). Of no effect on
        /// the CPU, in the encoder and in the decoder.
        cuda_graphs: bool = false;
        /// Whether the node changes to the model that /wm/model names, as the learner and its service use_model do. The
        /// models are folders on this computer.
        follow_model: bool = false;
    }
}

/// The parameters of a node that computes with the world model: its own, and `model`, `device`, `cuda_graphs` and
/// `follow_model`.
pub struct WithModel<P> {
    common: Common,
    own: P,
}

impl<P> Deref for WithModel<P> {
    type Target = P;

    fn deref(&self) -> &P {
        &self.own
    }
}

impl<P: ParameterSet> ParameterSet for WithModel<P> {
    fn specs() -> Vec<ParameterSpec> {
        let mut specs = Common::specs();
        specs.extend(P::specs());
        specs
    }

    fn declare(node: &Node) -> Result<Self, Error> {
        Ok(Self {
            common: Common::declare(node)?,
            own: P::declare(node)?,
        })
    }
}

impl<P> WithModel<P> {
    /// Whether the node changes to the models that `/wm/model` names.
    pub(crate) fn follows_model(&self) -> bool {
        self.common.follow_model
    }

    /// Parses `device` and `cuda_graphs`.
    fn compute(&self) -> Result<Compute> {
        let compute: Compute = self.common.device.parse()?;
        Ok(compute.recording(self.common.cuda_graphs))
    }
}

/// Opens the model on a separate thread, where `load` loads the parts that the node needs.
async fn load<P: Send + Sync + 'static, M: Send + 'static>(
    parameters: &Arc<WithModel<P>>,
    load: fn(ModelFolder, &P) -> Result<M>,
) -> Result<M> {
    let (parameters, span) = (Arc::clone(parameters), tracing::Span::current());
    let open = move || {
        let name = &parameters.common.model;
        span.in_scope(|| open(&parameters, name, load))
            .with_context(|| format!("parameter model is \"{name}\""))
    };
    tokio::task::spawn_blocking(open).await?
}

/// Opens the model `name`, of which `load` loads the parts that the node needs. It blocks.
fn open<P, M>(
    parameters: &WithModel<P>,
    name: &str,
    load: fn(ModelFolder, &P) -> Result<M>,
) -> Result<M> {
    let folder = ModelFolder::open(name)?.on(parameters.compute()?);
    for mark in folder.unfinished()? {
        tracing::warn!("{name}: the training of its {} is {mark}", mark.part);
    }
    load(folder, &parameters.own)
}
