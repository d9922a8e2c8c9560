//! How a node follows the robot: latents of its camera, its actions, resets, and clock jumps.
//!
//! The state keeps a [`History`](crate::history::History) and implements [`Follows`]; [`Follower::next`] waits for an
//! input, and [`Follower::tell`] hands it to the state, and counts what is wrong with it:
//!
//! ```no_run
//! use std::convert::Infallible;
//! use std::sync::Arc;
//! use wm_model_nodes::harness::{self, Follower, Follows, Inputs, Told, WithModel};
//! use wm_model_nodes::history::{
//!     Arrival, ChunkMerging, History, HistoryError, HistorySettings, Reception, Timing, Wait,
//! };
//! use wm_msgs::builtin_interfaces::Time;
//! use wm_msgs::std_msgs::Float32;
//! use wm_msgs::wm_msgs::{Action, ActionChunk, Latent};
//! use wm_ros::{
//!     Node, NodeDefinition, NodeProgram, Parameter, Publisher, Setup, complaints::Complaints,
//! };
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
//!         /// What follows the robot.
//!         inputs: Inputs;
//!         /// How much the newest latent differs from the one a model step before.
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
//!     type Seen = Option<Result<f32, Wait>>;
//!     type Due = Infallible;
//!
//!     fn latent(
//!         &mut self,
//!         latent: &Latent,
//!         reception: Reception,
//!     ) -> Result<(Arrival, Self::Seen), HistoryError> {
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
//! fn load(folder: ModelFolder, _: &Parameters) -> anyhow::Result<wm_model::WorldModel> {
//!     Ok(folder.world_model()?)
//! }
//!
//! impl NodeProgram for Change {
//!     const NAME: &'static str = "change";
//!     const ABOUT: &'static str = "Measures how much latents change in a model step.";
//!     const IS_MANAGED: bool = true;
//!     type Parameters = WithModel<Parameters>;
//!     type Endpoints = Endpoints;
//!     type Resources = wm_model::WorldModel;
//!     type Error = anyhow::Error;
//!
//!     fn check(parameters: &Self::Parameters) -> anyhow::Result<()> {
//!         parameters.check_device()
//!     }
//!
//!     async fn load(_: &Node, parameters: &Arc<Self::Parameters>) -> anyhow::Result<Self::Resources> {
//!         harness::load(parameters, load).await
//!     }
//!
//!     fn activate(at: &Setup<Self>) -> anyhow::Result<Self> {
//!         let model = &at.resources;
//!         let settings = HistorySettings {
//!             timing: Timing::of_camera(at.parameters.frame_period, &model.encoding),
//!             context_frames: 2,
//!             merging: ChunkMerging::Latest,
//!         };
//!         let (space, encoding) = (model.space.clone(), model.encoding.clone());
//!         let history = History::new(settings, space, encoding, at.node.now());
//!         Ok(Self {
//!             follower: Follower::new(&at.node, &at.endpoints.inputs, "start the encoder"),
//!             step: ChangeStep { history },
//!             complaints: Complaints::new(at.node.diagnostics()),
//!         })
//!     }
//!
//!     async fn run(&mut self, at: &mut Setup<Self>) -> anyhow::Result<()> {
//!         let Endpoints { inputs, changes } = &mut at.endpoints;
//!         while let Some(event) = self.follower.next(inputs).await {
//!             let told = self.follower.tell(event, &mut self.step, &mut self.complaints);
//!             match told {
//!                 Some(Told::Seen(Some(Ok(change)))) => {
//!                     self.complaints.working("measuring");
//!                     let is_change = f64::from(change) >= at.parameters.threshold.get();
//!                     let data = if is_change { change } else { 0.0 };
//!                     changes.publish(&Float32 { data })?;
//!                 }
//!                 Some(Told::Seen(Some(Err(wait)))) => {
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
//! pub const NODE: NodeDefinition<anyhow::Error> = NodeDefinition::of::<Change>();
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
    /// What a latent leads to; `()` where the node asks its state itself.
    type Seen;
    /// What a chunk that answers the newest frame triggers.
    type Due;

    /// Takes a latent, and returns what it leads to. If [`Arrival::held_back`] is set, the newest frame is still the one
    /// before.
    ///
    /// # Errors
    /// Why it is dropped.
    fn latent(
        &mut self,
        latent: &Latent,
        reception: Reception,
    ) -> Result<(Arrival, Self::Seen), HistoryError>;

    /// Takes an action, at `now` by the node's clock.
    ///
    /// # Errors
    /// Why it is dropped.
    fn action(&mut self, action: &Action, now: Time) -> Result<Arrival, HistoryError>;

    /// Takes a policy's chunk of actions, at `now` by the node's clock, and returns what that triggers.
    ///
    /// # Errors
    /// Why it is dropped.
    fn chunk(
        &mut self,
        chunk: &ActionChunk,
        now: Time,
    ) -> Result<(Arrival, Option<Self::Due>), HistoryError>;

    /// Forgets what was observed, takes the seed where there is one, and says what it did.
    fn reset(&mut self, seed: Option<u64>, now: Time) -> String;

    /// Forgets what lies ahead of `now`, and returns whether there was anything.
    fn clock_jumped(&mut self, now: Time) -> bool;
}

/// What is left to the node itself.
pub enum Told<F: Follows> {
    /// What a latent has led to.
    Seen(F::Seen),
    /// What a chunk has triggered.
    Due(F::Due),
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
}

impl Follower {
    /// From now on, reports missing latents on `/diagnostics`, with `advice`.
    pub fn new(node: &Node, inputs: &Inputs, advice: &'static str) -> Self {
        let expected = Input::new("latents", [inputs.latents.topic()], advice);
        node.diagnostics().expect_input(expected);
        Self {
            clock: node.clock(),
            jumps: node.clock().jumps(),
        }
    }

    /// The next input; `None` at the shutdown. Cancel safe.
    pub async fn next(&mut self, inputs: &mut Inputs) -> Option<Event> {
        // Actions and chunks before latents: those of a moment and its frame may all be there.
        tokio::select! {
            biased;
            Some(call) = inputs.resets.recv() => Some(Event::Reset(call)),
            Ok(()) = self.jumps.changed() => Some(Event::Jumped),
            received = inputs.actions.recv() => received.map(Event::Action),
            received = inputs.chunks.recv() => received.map(Event::Chunk),
            received = inputs.latents.recv_shared() => received.map(Event::Latent),
        }
    }

    /// Hands an input to the node's state, counts and reports what is wrong with it, and returns what it leads to.
    pub fn tell<F: Follows>(
        &self,
        event: Event,
        state: &mut F,
        complaints: &mut Complaints,
    ) -> Option<Told<F>> {
        let now = self.clock.now();
        match event {
            Event::Latent(received) => {
                let reception = Reception::of(&received, &self.clock);
                match state.latent(&received.message, reception) {
                    Ok((arrival, seen)) => {
                        note(complaints, Ok(arrival));
                        return Some(Told::Seen(seen));
                    }
                    Err(error) => note(complaints, Err(error)),
                }
            }
            Event::Action(received) => {
                let latest = Reception::of(&received, &self.clock).latest();
                let taken = state.action(&received.message, latest);
                note(complaints, taken);
            }
            Event::Chunk(received) => {
                let latest = Reception::of(&received, &self.clock).latest();
                match state.chunk(&received.message, latest) {
                    Ok((arrival, due)) => {
                        note(complaints, Ok(arrival));
                        return due.map(Told::Due);
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

/// Implements [`Follows`] for a state by its own methods. `$seen` and `$due` split what its `latent` and `chunk` return.
macro_rules! follows {
    ($step:ty, $seen:ty, |$latent:ident| $split_latent:expr, $due:ty, |$chunk:ident| $split_chunk:expr) => {
        impl $crate::harness::Follows for $step {
            type Seen = $seen;
            type Due = $due;

            fn latent(
                &mut self,
                latent: &Latent,
                reception: Reception,
            ) -> Result<(Arrival, $seen), HistoryError> {
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
            ) -> Result<(Arrival, Option<$due>), HistoryError> {
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
