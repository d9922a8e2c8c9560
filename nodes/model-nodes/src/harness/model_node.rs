//! The trait of a node that computes with the world model.

use std::sync::Arc;

use anyhow::Result;
use wm_model::LatentSpace;
use wm_ros::{EndpointSet, Node, NodeDefinition, NodeProgram, ParameterSet, Setup};
use wm_zoo::ModelFolder;

use super::{WithChoice, WithModel, changes::Changes, load};

/// A managed node that computes with the world model: a [`NodeProgram`] with the parameters of [`WithModel`], which the
/// frame checks, and a model, which the frame opens.
pub trait ModelNode: Sized + 'static {
    /// See [`NodeProgram::NAME`].
    const NAME: &'static str;
    /// See [`NodeProgram::ABOUT`].
    const ABOUT: &'static str;
    /// Its parameters, without those of every such node.
    type Parameters: ParameterSet + Send + Sync + 'static;
    /// See [`NodeProgram::Endpoints`].
    type Endpoints: EndpointSet + 'static;
    /// The parts of the model that it needs.
    type Model: Send + 'static;

    /// Whether the node makes the latents of the others. Then it changes to a model of another latent space after them.
    const MAKES_LATENTS: bool = false;

    /// The latent space of a model. A node with latents of others changes to a model of another space when the first
    /// latent of that space arrives. By default the node changes as soon as a model is loaded.
    fn space(_model: &Self::Model) -> Option<&LatentSpace> {
        None
    }

    /// Refuses inconsistent parameters.
    ///
    /// # Errors
    /// Names them.
    fn check(_parameters: &Self::Parameters) -> Result<()> {
        Ok(())
    }

    /// Loads the parts of the model. It may block.
    ///
    /// # Errors
    /// Names the missing or invalid part.
    fn load(folder: ModelFolder, parameters: &Self::Parameters) -> Result<Self::Model>;

    /// See [`NodeProgram::activate`].
    ///
    /// # Errors
    /// See [`NodeProgram::activate`].
    fn activate(at: &ModelSetup<Self>) -> Result<Self>;

    /// See [`NodeProgram::run`].
    ///
    /// # Errors
    /// See [`NodeProgram::run`].
    fn run(&mut self, at: &mut ModelSetup<Self>) -> impl Future<Output = Result<()>>;

    /// Changes to another model, between two `await`s of `run`. By default the node starts anew.
    ///
    /// # Errors
    /// As [`Self::activate`]; it ends the node.
    fn adopt(&mut self, at: &mut ModelSetup<Self>, model: Self::Model) -> Result<()> {
        at.resources = model;
        *self = Self::activate(at)?;
        Ok(())
    }
}

/// A [`ModelNode`] as a [`NodeProgram`].
pub struct ModelProgram<N: ModelNode> {
    node: N,
    changes: Changes<N>,
}

/// What a [`ModelNode`] works with.
pub type ModelSetup<N> = Setup<ModelProgram<N>>;

/// The definition of a node, for the registry `NODES`.
#[must_use]
pub const fn definition<N: ModelNode>() -> NodeDefinition<anyhow::Error> {
    NodeDefinition::of::<ModelProgram<N>>()
}

impl<N: ModelNode> NodeProgram for ModelProgram<N> {
    const NAME: &'static str = N::NAME;
    const ABOUT: &'static str = N::ABOUT;
    const IS_MANAGED: bool = true;
    type Parameters = WithModel<N::Parameters>;
    type Endpoints = WithChoice<N::Endpoints>;
    type Resources = N::Model;
    type Error = anyhow::Error;

    fn check(parameters: &Self::Parameters) -> Result<()> {
        N::check(parameters)?;
        // A malformed device ends the node at once, not at its configuration.
        parameters.compute().map(drop)
    }

    async fn load(_: &Node, parameters: &Arc<Self::Parameters>) -> Result<N::Model> {
        load(parameters, N::load).await
    }

    fn activate(at: &Setup<Self>) -> Result<Self> {
        Ok(Self {
            node: N::activate(at)?,
            changes: Changes::of(at),
        })
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        loop {
            let model = tokio::select! {
                ended = self.node.run(at) => return ended,
                model = self.changes.next() => model?,
            };
            self.node.adopt(at, model)?;
        }
    }
}
