//! Changes to another model while a node works.

use std::{
    ops::{Deref, DerefMut},
    sync::Arc,
};

use anyhow::Result;
use tokio::{sync::Mutex, time::Instant};
use wm_model::LatentSpace;
use wm_msgs::wm_msgs::Model as ModelMessage;
use wm_ros::{
    EndpointSet, EndpointSpec, Error, Level, Node, Qos, Subscription, complaints::Complaints,
};

use super::{Handover, ModelNode, ModelSetup, handover::ChangeTime, open};
use crate::work::Work;

wm_ros::endpoints! {
    /// The topic that names the model.
    struct Choice {
        /// The model to change to, if the parameter follow_model is set. The node works with the previous one until the
        /// new one is loaded and, if its latent space is another one, until the first latent of that space arrives.
        models: Subscription<ModelMessage> = "model", qos(Qos::latched(1));
    }
}

/// The endpoints of a node that computes with the world model: its own, and the topic that names the model.
pub struct WithChoice<E> {
    own: E,
    /// Apart from `own`, which the node's `run` borrows.
    models: Arc<Mutex<Subscription<ModelMessage>>>,
    handover: Handover,
}

impl<E> WithChoice<E> {
    /// Keeps messages of another latent space while the node changes to a model of that space, for
    /// [`Follower::keeping`](super::Follower::keeping).
    #[must_use]
    pub fn handover(&self) -> Handover {
        self.handover.clone()
    }
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
            handover: Handover::default(),
        })
    }
}

/// A model's name, and the loaded parts or the reason why they cannot be loaded.
type Loaded<M> = (String, Result<M>);

/// A loaded model that the node does not work with yet.
struct Waiting<M> {
    name: String,
    model: M,
    time: ChangeTime,
}

/// The models that a node is to change to, loaded off the message loop.
pub(super) struct Changes<N: ModelNode> {
    models: Arc<Mutex<Subscription<ModelMessage>>>,
    loading: Work<String, Loaded<N::Model>>,
    waiting: Option<Waiting<N::Model>>,
    handover: Handover,
    is_followed: bool,
    /// The model that the node works with, and its latent space.
    present: (String, Option<LatentSpace>),
    complaints: Complaints,
    node: Node,
}

impl<N: ModelNode> Changes<N> {
    pub(super) fn of(at: &ModelSetup<N>) -> Self {
        let parameters = Arc::clone(&at.parameters);
        let common = &at.parameters.common;
        let handover = at.endpoints.handover();
        handover.clear();
        Self {
            models: Arc::clone(&at.endpoints.models),
            is_followed: common.follow_model,
            present: (common.model.clone(), N::space(&at.resources).cloned()),
            loading: Work::new(1, move |name: String, _| {
                let model = open(&parameters, &name, N::load);
                (name, model)
            }),
            waiting: None,
            handover,
            complaints: Complaints::new(at.node.diagnostics()),
            node: at.node.clone(),
        }
    }

    /// The next model, once it is loaded and the node has to change to it. A model that cannot be loaded is reported,
    /// and the node keeps its own.
    pub(super) async fn next(&mut self) -> Result<N::Model> {
        let models = Arc::clone(&self.models);
        let mut models = models.lock().await;
        loop {
            tokio::select! {
                loaded = self.loading.finished() => self.loaded(loaded?),
                has_latent = wait(&self.handover, self.waiting.as_ref()) => {
                    if let Some(Waiting { name, model, .. }) = self.waiting.take() {
                        if !has_latent {
                            tracing::warn!("no latent of model {name} has arrived, is the encoder's follow_model set?");
                        }
                        tracing::info!("changing from model {} to {name}", self.present.0);
                        self.node.diagnostics().set_value("model", &name);
                        self.present = (name, N::space(&model).cloned());
                        self.end();
                        return Ok(model);
                    }
                }
                Some(received) = models.recv() => self.named(received.message.model),
            }
        }
    }

    fn loaded(&mut self, (name, model): Loaded<N::Model>) {
        match model {
            Ok(model) => {
                let (present, new) = (self.present.1.as_ref(), N::space(&model));
                let time = ChangeTime::of(present, new, N::MAKES_LATENTS, Instant::now());
                self.waiting = Some(Waiting { name, model, time });
            }
            Err(error) => {
                let text = format!("{error:#}; still working with {}", self.present.0);
                self.complaints.left_out("bad_model", &text);
                self.node.diagnostics().raise("model", Level::Warn, text);
                self.end();
            }
        }
    }

    /// Ends a change, unless another one is in progress.
    fn end(&mut self) {
        let is_coming = self.loading.is_running() || self.waiting.is_some();
        let dropped = self.handover.end(self.present.1.as_ref(), is_coming);
        if dropped > 0 {
            let text = "they are of the latent space of a model that the node did not change to";
            self.complaints.left_out_many("wrong_space", dropped, &text);
        }
    }

    fn named(&mut self, name: String) {
        if !self.is_followed {
            let text = format_args!("model {name}: the parameter follow_model is not set");
            return self.complaints.left_out("other_model", &text);
        }
        if name != self.present.0 || self.loading.is_running() {
            self.handover.begin();
            // Only the newest counts.
            let _ = self.loading.submit(name);
        } else if self.waiting.take().is_some() {
            // Back to the present model.
            self.end();
        }
    }
}

/// Waits until the node has to change to the waiting model; returns whether latents for it arrive. Never without one.
async fn wait<M>(handover: &Handover, waiting: Option<&Waiting<M>>) -> bool {
    match waiting {
        Some(waiting) => handover.wait(&waiting.time).await,
        None => std::future::pending().await,
    }
}
