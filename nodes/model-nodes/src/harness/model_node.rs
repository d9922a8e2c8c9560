//! The trait of a node that computes with the world model.

use std::sync::Arc;

use anyhow::Result;
use wm_ros::{EndpointSet, Node, NodeDefinition, NodeProgram, ParameterSet, Setup};
use wm_zoo::ModelFolder;

use super::{WithModel, load};

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
}

/// A [`ModelNode`] as a [`NodeProgram`].
pub struct ModelProgram<N>(N);

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
    type Endpoints = N::Endpoints;
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
        N::activate(at).map(Self)
    }

    async fn run(&mut self, at: &mut Setup<Self>) -> Result<()> {
        self.0.run(at).await
    }
}
