//! How a node follows the robot: latents of its camera, its actions, resets, and jumps of the clock.

use std::fmt::Display;

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
    evaluator::{EvaluatorError, EvaluatorStep},
    planner::{PlannerError, PlannerStep},
    predictor::{PredictorError, PredictorStep},
    timeline::Arrival,
};

wm_ros::endpoints! {
    /// What a node hears that follows the robot.
    pub struct Inputs {
        /// Latents of the camera's frames.
        pub latents: Subscription<Latent> = "latent", qos(LATENT_QOS);
        /// Actions that the robot takes.
        pub actions: Subscription<Action> = "action";
        /// Actions that a policy is about to take.
        chunks: Subscription<ActionChunk> = "action_chunk";
        /// Forgets what was observed, and takes the seed of the request.
        resets: Service<Reset> = "~/reset", made(|node, name, _| {
            node.service_or_refuse(name, |reason| ResetResponse { success: false, message: reason.to_owned() })
        });
    }
}

/// The state of a node that follows the robot.
pub trait History {
    /// Why a message is left out.
    type Error: Reason;

    /// Takes an action.
    ///
    /// # Errors
    /// Why it is left out.
    fn action(&mut self, action: &Action) -> Result<Arrival, Self::Error>;

    /// Takes a policy's chunk of actions.
    ///
    /// # Errors
    /// Why it is left out.
    fn chunk(&mut self, chunk: &ActionChunk) -> Result<(), Self::Error>;

    /// Forgets what was observed, takes the seed where there is one, and says what it did.
    fn reset(&mut self, seed: Option<u64>) -> String;

    /// Forgets what lies ahead of `now`; whether there was anything.
    fn clock_jumped(&mut self, now: Time) -> bool;
}

/// An error that is counted by its reason.
pub trait Reason: Display {
    /// In one word, for the counters on `/diagnostics`.
    fn reason(&self) -> &'static str;
}

/// Something that came.
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
    Latent(Received<Latent>),
}

/// Follows the robot while the node is active.
pub struct Follower {
    clock: Clock,
    jumps: watch::Receiver<u64>,
}

impl Follower {
    /// Misses latents on `/diagnostics` from now on where they stay away, as `advice` says what to do about.
    pub fn new(node: &Node, inputs: &Inputs, advice: &'static str) -> Self {
        let expected = Input::new("latents", [inputs.latents.topic()], advice);
        node.diagnostics().expect_input(expected);
        Self {
            clock: node.clock(),
            jumps: node.clock().jumps(),
        }
    }

    /// What comes next; `None` at the shutdown. Cancel safe.
    pub async fn next(&mut self, inputs: &mut Inputs) -> Option<Event> {
        // Actions and chunks before latents: those of a moment and its frame may all be there.
        tokio::select! {
            biased;
            Some(call) = inputs.resets.recv() => Some(Event::Reset(call)),
            Ok(()) = self.jumps.changed() => Some(Event::Jumped),
            received = inputs.actions.recv() => received.map(Event::Action),
            received = inputs.chunks.recv() => received.map(Event::Chunk),
            received = inputs.latents.recv() => received.map(Event::Latent),
        }
    }

    /// Tells the node's state of it. A latent comes back: what a frame sets off is the node's own.
    pub fn tell<H: History>(
        &self,
        event: Event,
        history: &mut H,
        complaints: &mut Complaints,
    ) -> Option<Received<Latent>> {
        match event {
            Event::Latent(received) => return Some(received),
            Event::Action(received) => {
                let taken = history.action(&received.message);
                note(taken, complaints);
            }
            Event::Chunk(received) => {
                let taken = history.chunk(&received.message);
                note(taken.map(|()| Arrival::default()), complaints);
            }
            Event::Jumped => {
                if history.clock_jumped(self.clock.now()) {
                    tracing::info!("/clock jumped back: history flushed");
                }
            }
            Event::Reset(call) => {
                let seed = (!call.request.keep_seed).then_some(call.request.seed);
                let message = history.reset(seed);
                tracing::info!("reset: {message}");
                let success = true;
                answer(call, &ResetResponse { success, message });
            }
        }
        None
    }
}

/// Reports what a message did to the history; the arrival, where it was taken.
pub fn note<E: Reason>(taken: Result<Arrival, E>, complaints: &mut Complaints) -> Option<Arrival> {
    match taken {
        Ok(arrival) => {
            if arrival.flushed {
                tracing::info!("stamps are more than a second apart: history flushed");
            }
            if let Some(late) = arrival.late_chunk {
                complaints.left_out("untimely_action", &late);
            }
            Some(arrival)
        }
        Err(error) => {
            complaints.left_out(error.reason(), &error);
            None
        }
    }
}

/// The states of the nodes, whose own methods do it.
macro_rules! histories {
    ($($step:ty, $error:ty, |$state:ident, $message:ident| $chunk:expr;)*) => {
        $(
            impl History for $step {
                type Error = $error;

                fn action(&mut self, action: &Action) -> Result<Arrival, $error> {
                    self.action(action)
                }

                fn chunk(&mut self, $message: &ActionChunk) -> Result<(), $error> {
                    let $state = self;
                    $chunk
                }

                fn reset(&mut self, seed: Option<u64>) -> String {
                    self.reset(seed)
                }

                fn clock_jumped(&mut self, now: Time) -> bool {
                    self.clock_jumped(now)
                }
            }

            impl Reason for $error {
                fn reason(&self) -> &'static str {
                    self.reason()
                }
            }
        )*
    };
}

histories! {
    PredictorStep, PredictorError, |step, chunk| step.chunk(chunk);
    PlannerStep, PlannerError, |step, chunk| step.chunk(chunk);
    // its candidates stand for what is about to be done
    EvaluatorStep, EvaluatorError, |_step, _chunk| Ok(());
}
