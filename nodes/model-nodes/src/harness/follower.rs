//! The inputs of a node that follows the robot: latents, actions, chunks, resets and clock jumps.
//!
//! The state keeps a [`History`](crate::history::History) and implements [`Follows`]. [`Follower::next`] waits for an
//! input. [`Follower::apply`] applies it to the state, and counts and reports faults. [`Follower::keeping`] is for nodes
//! whose [`ModelNode::space`](super::ModelNode::space) names the space of their model.
//!
//! ```no_run
//! use std::convert::Infallible;
//! use wm_model_nodes::harness::{self, Follower, Follows, Inputs, ModelNode, ModelSetup, Outcome};
//! use wm_model_nodes::history::{
//!     Arrival, ChunkMerging, History, HistoryBuilder, HistoryError, Reception, Wait,
//! };
//! use wm_msgs::builtin_interfaces::Time;
//! use wm_msgs::std_msgs::Float32;
//! use wm_msgs::wm_msgs::{Action, ActionChunk, Latent};
//! use wm_ros::{NodeDefinition, Parameter, Publisher, complaints::Complaints};
//! use wm_zoo::ModelFolder;
//!
//! wm_ros::parameters! {
//!     /// Its parameters.
//!     struct Parameters {
//!         /// Changes below this are published as 0 [normalised units squared].
//!         threshold: Parameter<f64> = 0.05, in 0.0..=10.0;
//!         /// Time between camera frames [s].
//!         frame_period: f64 = 0.2, in 1e-3..=60.0;
//!     }
//! }
//!
//! wm_ros::endpoints! {
//!     /// Its topics and services.
//!     struct Endpoints {
//!         /// Inputs about the robot.
//!         inputs: Inputs;
//!         /// The difference between the newest latent and that of one model step earlier.
//!         changes: Publisher<Float32> = "change";
//!     }
//! }
//!
//! /// The pure step: messages in, messages out.
//! struct ChangeStep {
//!     history: History,
//! }
//!
//! impl ChangeStep {
//!     fn change(&self) -> Result<f32, Wait> {
//!         let moment = self.history.moment()?;
//!         let before = moment.earlier.last().ok_or(Wait::NoFrame)?;
//!         let pairs = moment.observed.values.iter().zip(before.values.iter());
//!         Ok(pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>() / before.values.len() as f32)
//!     }
//! }
//!
//! impl Follows for ChangeStep {
//!     type OnLatent = Option<Result<f32, Wait>>;
//!     type OnChunk = Infallible;
//!
//!     fn latent(
//!         &mut self,
//!         latent: &Latent,
//!         reception: Reception,
//!     ) -> Result<(Arrival, Self::OnLatent), HistoryError> {
//!         let arrival = self.history.latent(latent, reception)?;
//!         Ok((arrival, (!arrival.held_back).then(|| self.change())))
//!     }
//!
//!     fn action(&mut self, action: &Action, now: Time) -> Result<Arrival, HistoryError> {
//!         self.history.action(action, now)
//!     }
//!
//!     fn chunk(
//!         &mut self,
//!         chunk: &ActionChunk,
//!         now: Time,
//!     ) -> Result<(Arrival, Option<Infallible>), HistoryError> {
//!         Ok((self.history.chunk(chunk, now)?, None))
//!     }
//!
//!     fn reset(&mut self, _seed: Option<u64>, now: Time) -> String {
//!         self.history.reset(now);
//!         "forgot all frames and actions".to_owned()
//!     }
//!
//!     fn clock_jumped(&mut self, now: Time) -> bool {
//!         self.history.clock_jumped(now)
//!     }
//! }
//!
//! struct Change {
//!     follower: Follower,
//!     step: ChangeStep,
//!     complaints: Complaints,
//! }
//!
//! impl ModelNode for Change {
//!     const NAME: &'static str = "change";
//!     const ABOUT: &'static str = "Measures how much latents change in a model step.";
//!     type Parameters = Parameters;
//!     type Endpoints = Endpoints;
//!     type Model = HistoryBuilder;
//!
//!     fn load(folder: ModelFolder, parameters: &Parameters) -> anyhow::Result<HistoryBuilder> {
//!         let (context_frames, merging) = (2, ChunkMerging::Latest);
//!         let model = folder.world_model()?;
//!         Ok(HistoryBuilder::new(&model, parameters.frame_period, context_frames, merging))
//!     }
//!
//!     fn activate(at: &ModelSetup<Self>) -> anyhow::Result<Self> {
//!         let history = at.resources.begin(at.node.now());
//!         Ok(Self {
//!             follower: Follower::new(&at.node, &at.endpoints.inputs, "start the encoder"),
//!             step: ChangeStep { history },
//!             complaints: Complaints::new(at.node.diagnostics()),
//!         })
//!     }
//!
//!     async fn run(&mut self, at: &mut ModelSetup<Self>) -> anyhow::Result<()> {
//!         let Endpoints { inputs, changes } = &mut *at.endpoints;
//!         while let Some(event) = self.follower.next(inputs).await {
//!             match self.follower.apply(event, &mut self.step, &mut self.complaints) {
//!                 Some(Outcome::Latent(Some(Ok(change)))) => {
//!                     self.complaints.working("measuring");
//!                     let is_change = f64::from(change) >= at.parameters.threshold.get();
//!                     let data = if is_change { change } else { 0.0 };
//!                     changes.publish(&Float32 { data })?;
//!                 }
//!                 Some(Outcome::Latent(Some(Err(wait)))) => {
//!                     self.complaints.waiting(wait.kind(), wait.is_usual(), &wait);
//!                 }
//!                 _ => {}
//!             }
//!         }
//!         Ok(())
//!     }
//! }
//!
//! /// For the registry, `NODES` in `lib.rs`.
//! pub const NODE: NodeDefinition<anyhow::Error> = harness::definition::<Change>();
//! ```

use std::sync::Arc;

use tokio::sync::watch;
use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Action, ActionChunk, Latent, Reset, ResetResponse},
};
use wm_ros::{
    Call, Clock, Input, Node, Received, Service, Subscription, answer, complaints::Complaints,
};
use wm_wire::latent_message::LATENT_QOS;

use super::{Handover, KeptMessage};
use crate::history::{Arrival, HistoryError, Reception, note};

wm_ros::endpoints! {
    /// The inputs of a node that follows the robot.
    pub struct Inputs {
        /// Latents of the camera's frames.
        pub latents: Subscription<Latent> = "latent", qos(LATENT_QOS);
        /// Actions that the robot takes.
        pub actions: Subscription<Action> = "action";
        /// Actions that a policy will take next.
        chunks: Subscription<ActionChunk> = "action_chunk";
        /// Forgets the observed history. A node with a seed takes that of the request.
        resets: Service<Reset> = "~/reset", made(|node, name, _| {
            node.service_or_refuse(name, |reason| ResetResponse { success: false, message: reason.to_owned() })
        });
    }
}

/// The state of a node that follows the robot.
pub trait Follows {
    /// The effect of a latent; `()` if the node queries its state itself.
    type OnLatent;
    /// The effect of a chunk that answers the newest frame.
    type OnChunk;

    /// Takes a latent, and returns its effect. If [`Arrival::held_back`] is set, the newest frame is still the previous
    /// one.
    ///
    /// # Errors
    /// The reason why it is dropped.
    fn latent(
        &mut self,
        latent: &Latent,
        reception: Reception,
    ) -> Result<(Arrival, Self::OnLatent), HistoryError>;

    /// Takes an action, at `now` by the node's clock.
    ///
    /// # Errors
    /// The reason why it is dropped.
    fn action(&mut self, action: &Action, now: Time) -> Result<Arrival, HistoryError>;

    /// Takes a policy's chunk of actions, at `now` by the node's clock, and returns its effect.
    ///
    /// # Errors
    /// The reason why it is dropped.
    fn chunk(
        &mut self,
        chunk: &ActionChunk,
        now: Time,
    ) -> Result<(Arrival, Option<Self::OnChunk>), HistoryError>;

    /// Forgets all observations, takes the seed if there is one, and returns a text about that for the log and the
    /// caller.
    fn reset(&mut self, seed: Option<u64>, now: Time) -> String;

    /// Forgets everything stamped after `now`, and returns whether there was anything.
    fn clock_jumped(&mut self, now: Time) -> bool;
}

/// The effect of an input, which the node itself has to handle.
pub enum Outcome<F: Follows> {
    /// The effect of a latent.
    Latent(F::OnLatent),
    /// The effect of a chunk.
    Chunk(F::OnChunk),
}

/// An input.
pub enum Event {
    /// A call of `~/reset`.
    Reset(Call<Reset>),
    /// `/clock` went back.
    Jumped,
    /// An action.
    Action(Received<Action>),
    /// A chunk.
    Chunk(Received<ActionChunk>),
    /// A latent.
    Latent(Received<Arc<Latent>>),
}

/// Follows the robot while the node is active.
pub struct Follower {
    clock: Clock,
    jumps: watch::Receiver<u64>,
    handover: Handover,
}

impl Follower {
    /// Follows from now on, and reports missing latents on `/diagnostics` with this `advice`.
    pub fn new(node: &Node, inputs: &Inputs, advice: &'static str) -> Self {
        let expected = Input::new("latents", [inputs.latents.topic()], advice);
        node.diagnostics().expect_input(expected);
        Self {
            clock: node.clock(),
            jumps: node.clock().jumps(),
            handover: Handover::default(),
        }
    }

    /// The same, keeping latents of another space while the node changes to a model of that space.
    #[must_use]
    pub fn keeping(self, handover: Handover) -> Self {
        Self { handover, ..self }
    }

    /// The next input; `None` at the shutdown. Cancel safe.
    pub async fn next(&mut self, inputs: &mut Inputs) -> Option<Event> {
        if let Some(kept) = self.handover.latent() {
            return Some(Event::Latent(kept));
        }
        // Actions and chunks first: if those of a moment wait together with its frame, the frame needs them.
        tokio::select! {
            biased;
            Some(call) = inputs.resets.recv() => Some(Event::Reset(call)),
            Ok(()) = self.jumps.changed() => Some(Event::Jumped),
            received = inputs.actions.recv() => received.map(Event::Action),
            received = inputs.chunks.recv() => received.map(Event::Chunk),
            received = inputs.latents.recv_shared() => received.map(Event::Latent),
        }
    }

    /// Applies an input to the node's state, counts and reports its faults, and returns its effect.
    pub fn apply<F: Follows>(
        &self,
        event: Event,
        state: &mut F,
        complaints: &mut Complaints,
    ) -> Option<Outcome<F>> {
        let now = self.clock.now();
        match event {
            Event::Latent(received) => {
                let reception = Reception::of(&received, &self.clock);
                match state.latent(&received.message, reception) {
                    Ok((arrival, effect)) => {
                        note(complaints, Ok(arrival));
                        return Some(Outcome::Latent(effect));
                    }
                    Err(error) => {
                        let is_kept = error.is_other_space()
                            && self.handover.keep(KeptMessage::Latent(received));
                        if !is_kept {
                            note(complaints, Err(error));
                        }
                    }
                }
            }
            Event::Action(received) => {
                let latest = Reception::of(&received, &self.clock).latest();
                note(complaints, state.action(&received.message, latest));
            }
            Event::Chunk(received) => {
                let latest = Reception::of(&received, &self.clock).latest();
                match state.chunk(&received.message, latest) {
                    Ok((arrival, effect)) => {
                        note(complaints, Ok(arrival));
                        return effect.map(Outcome::Chunk);
                    }
                    Err(error) => note(complaints, Err(error)),
                }
            }
            Event::Jumped => {
                if state.clock_jumped(now) {
                    tracing::info!("/clock jumped back: starting a new history");
                }
            }
            Event::Reset(call) => {
                let seed = (!call.request.keep_seed).then_some(call.request.seed);
                let message = state.reset(seed, now);
                tracing::info!("reset: {message}");
                let success = true;
                answer(call, &ResetResponse { success, message });
            }
        }
        None
    }
}

/// Implements [`Follows`] for a state by its own methods. `$split_latent` and `$split_chunk` split the results of its
/// `latent` and `chunk` into arrival and effect.
macro_rules! follows {
    (
        $step:ty,
        $on_latent:ty,
        |$latent:ident| $split_latent:expr,
        $on_chunk:ty,
        |$chunk:ident| $split_chunk:expr
    ) => {
        impl $crate::harness::Follows for $step {
            type OnLatent = $on_latent;
            type OnChunk = $on_chunk;

            fn latent(
                &mut self,
                latent: &Latent,
                reception: Reception,
            ) -> Result<(Arrival, $on_latent), HistoryError> {
                let $latent = self.latent(latent, reception)?;
                Ok($split_latent)
            }

            fn action(&mut self, action: &Action, now: Time) -> Result<Arrival, HistoryError> {
                self.action(action, now)
            }

            fn chunk(
                &mut self,
                chunk: &ActionChunk,
                now: Time,
            ) -> Result<(Arrival, Option<$on_chunk>), HistoryError> {
                let $chunk = self.chunk(chunk, now)?;
                Ok($split_chunk)
            }

            fn reset(&mut self, seed: Option<u64>, now: Time) -> String {
                self.reset(seed, now)
            }

            fn clock_jumped(&mut self, now: Time) -> bool {
                self.clock_jumped(now)
            }
        }
    };
}
pub(crate) use follows;
