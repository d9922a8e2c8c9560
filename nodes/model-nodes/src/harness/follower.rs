//! How a node follows the robot: latents of its camera, its actions, resets, and clock jumps.

use std::sync::Arc;

use tokio::sync::watch;
use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Action, ActionChunk, Latent, Reset, ResetResponse},
};
use wm_ros::{
    Call, Clock, Input, Node, Received, Service, Subscription, calls::answer,
    complaints::Complaints,
};
use wm_wire::latent_message::LATENT_QOS;

use crate::{
    evaluator::EvaluatorStep,
    history::{Arrival, HistoryError, note},
    planner::PlannerStep,
    predictor::{PredictorStep, RolloutRequest},
};

wm_ros::endpoints! {
    /// The inputs of a node that follows the robot.
    pub struct Inputs {
        /// Latents of the camera's frames.
        pub latents: Subscription<Latent> = "latent", qos(LATENT_QOS);
        /// Actions that the robot takes.
        pub actions: Subscription<Action> = "action";
        /// Actions that a policy will take next.
        chunks: Subscription<ActionChunk> = "action_chunk";
        /// Forgets the observed history, and takes the seed of the request.
        resets: Service<Reset> = "~/reset", made(|node, name, _| {
            node.service_or_refuse(name, |reason| ResetResponse { success: false, message: reason.to_owned() })
        });
    }
}

/// The state of a node that follows the robot.
pub trait Follows {
    /// What a chunk that answers the newest frame triggers.
    type Due;

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
pub enum Told<D> {
    /// A latent.
    Latent(Received<Arc<Latent>>),
    /// What a chunk has triggered.
    Due(D),
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

    /// Tells the node's state of it. A latent comes back, and what a chunk sets off: what becomes of them is the node's
    /// own.
    pub fn tell<F: Follows>(
        &self,
        event: Event,
        state: &mut F,
        complaints: &mut Complaints,
    ) -> Option<Told<F::Due>> {
        let now = self.clock.now();
        match event {
            Event::Latent(received) => return Some(Told::Latent(received)),
            Event::Action(received) => {
                let taken = state.action(&received.message, received.received);
                note(complaints, taken);
            }
            Event::Chunk(received) => match state.chunk(&received.message, received.received) {
                Ok((arrival, due)) => {
                    note(complaints, Ok(arrival));
                    return due.map(Told::Due);
                }
                Err(error) => {
                    note(complaints, Err(error));
                }
            },
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

/// The states of the nodes, whose own methods do it.
macro_rules! follows {
    ($($step:ty, $due:ty, |$outcome:ident| $split:expr;)*) => {
        $(
            impl Follows for $step {
                type Due = $due;

                fn action(&mut self, action: &Action, now: Time) -> Result<Arrival, HistoryError> {
                    self.action(action, now)
                }

                fn chunk(
                    &mut self,
                    chunk: &ActionChunk,
                    now: Time,
                ) -> Result<(Arrival, Option<$due>), HistoryError> {
                    let $outcome = self.chunk(chunk, now)?;
                    Ok($split)
                }

                fn reset(&mut self, seed: Option<u64>, now: Time) -> String {
                    self.reset(seed, now)
                }

                fn clock_jumped(&mut self, now: Time) -> bool {
                    self.clock_jumped(now)
                }
            }
        )*
    };
}

follows! {
    PredictorStep, RolloutRequest, |outcome| (outcome.arrival, outcome.rollout.and_then(Result::ok));
    PlannerStep, std::convert::Infallible, |arrival| (arrival, None);
    EvaluatorStep, std::convert::Infallible, |arrival| (arrival, None);
}
