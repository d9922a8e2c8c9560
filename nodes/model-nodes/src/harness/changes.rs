//! Changes to another model while a node works.

use std::{
    ops::{Deref, DerefMut},
    sync::Arc,
};

use anyhow::Result;
use tokio::sync::Mutex;
use wm_msgs::wm_msgs::Model as ModelMessage;
use wm_ros::{
    EndpointSet, EndpointSpec, Error, Level, Node, Qos, Subscription, complaints::Complaints,
};

use super::{ModelNode, ModelSetup, open};
use crate::work::Work;

wm_ros::endpoints! {
    /// The topic that names the model.
    struct Choice {
        /// The model to change to, if the parameter follow_model is set. The node works with the previous one until the
        /// new one is loaded.
        models: Subscription<ModelMessage> = "model", qos(Qos::latched(1));
    }
}

/// The endpoints of a node that computes with the world model: its own, and the topic that names the model.
pub struct WithChoice<E> {
    own: E,
    /// Apart from `own`, which the node's `run` borrows.
    models: Arc<Mutex<Subscription<ModelMessage>>>,
}

impl<E> Deref for WithChoice<E> {
    type Target = E;

    fn deref(&self) -> &E {
        &self.own
    }
}

impl<E> DerefMut for WithChoice<E> {
    fn deref_mut(&mut self) -> &mut E {
        &mut self.own
    }
}

impl<E: EndpointSet> EndpointSet for WithChoice<E> {
    fn specs() -> Vec<EndpointSpec> {
        let mut specs = E::specs();
        specs.extend(Choice::specs());
        specs
    }

    fn make(node: &Node) -> Result<Self, Error> {
        Ok(Self {
            own: E::make(node)?,
            models: Arc::new(Mutex::new(Choice::make(node)?.models)),
        })
    }
}

/// A model's name, and the loaded parts or the reason why they cannot be loaded.
type Loaded<M> = (String, Result<M>);

/// The models that a node is to change to, loaded off the message loop.
pub(super) struct Changes<N: ModelNode> {
    models: Arc<Mutex<Subscription<ModelMessage>>>,
    loading: Work<String, Loaded<N::Model>>,
    is_followed: bool,
    /// The model that the node works with.
    present: String,
    complaints: Complaints,
    node: Node,
}

impl<N: ModelNode> Changes<N> {
    pub(super) fn of(at: &ModelSetup<N>) -> Self {
        let parameters = Arc::clone(&at.parameters);
        let common = &at.parameters.common;
        Self {
            models: Arc::clone(&at.endpoints.models),
            is_followed: common.follow_model,
            present: common.model.clone(),
            loading: Work::new(1, move |name: String, _| {
                let model = open(&parameters, &name, N::load);
                (name, model)
            }),
            complaints: Complaints::new(at.node.diagnostics()),
            node: at.node.clone(),
        }
    }

    /// The next model, once it is loaded. A model that cannot be loaded is reported, and the node keeps its own.
    pub(super) async fn next(&mut self) -> Result<N::Model> {
        let models = Arc::clone(&self.models);
        let mut models = models.lock().await;
        loop {
            tokio::select! {
                loaded = self.loading.finished() => {
                    let (name, model) = loaded?;
                    match model {
                        Ok(model) => {
                            tracing::info!("changing from model {} to {name}", self.present);
                            self.node.diagnostics().set_value("model", &name);
                            self.present = name;
                            return Ok(model);
                        }
                        Err(error) => {
                            let text = format!("{error:#}; still working with {}", self.present);
                            self.complaints.left_out("bad_model", &text);
                            self.node.diagnostics().raise("model", Level::Warn, text);
                        }
                    }
                }
                Some(received) = models.recv() => self.named(received.message.model),
            }
        }
    }

    fn named(&mut self, name: String) {
        if !self.is_followed {
            let text = format_args!("model {name}: the parameter follow_model is not set");
            return self.complaints.left_out("other_model", &text);
        }
        if name != self.present || self.loading.is_running() {
            // Only the newest counts.
            let _ = self.loading.submit(name);
        }
    }
}
