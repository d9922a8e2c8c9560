//! Managed nodes: their states, and the services and the topic that report and change them, as in rclcpp_lifecycle
//! (<https://design.ros2.org/articles/node_lifecycle.html>).
//!
//! A node implements [`Managed`]: the values that it makes when it is configured and activated. [`Lifecycle`] makes and drops
//! them on request. The state of a node is thus a value, and nothing of a dropped value remains.

mod gate;
mod machine;
mod services;
mod state;
mod transition;

pub(crate) use gate::{Gate, GatedEndpoint};
pub use machine::{Machine, Refused};
pub use state::State;
pub use transition::{Outcome, Transition};

use crate::{Call, Error, Level, Node, ParameterSpec, Publisher, Qos, Service};
use std::{
    fmt::Display,
    pin::pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};
use wm_msgs::lifecycle_msgs::{ChangeState, ChangeStateResponse, TransitionEvent};

/// The default of publishers in rcl_lifecycle.
const EVENTS_QOS: Qos = Qos::reliable(10);

/// How long a node waits at its shutdown until all subscribers have acknowledged the last transition.
const FAREWELL: Duration = Duration::from_millis(500);

/// The work of a node in each transition.
pub trait Managed {
    /// Its resources from configure to cleanup: weights, publishers, subscriptions, services.
    type Configured;
    /// Its state while active: history, work under way. Deactivating drops it.
    type Active;
    /// Its errors.
    type Error: From<Error> + Display;

    /// Loads the resources, and makes the endpoints. Endpoints made by this handle of the node are silent while the
    /// node is not active: publishers send nothing, subscriptions skip samples (a latched message is delivered on
    /// activation), services made by [`Node::service_or_refuse`] refuse, action servers reject.
    ///
    /// # Errors
    /// Any error; the node stays unconfigured.
    fn configure(&self, node: &Node)
    -> impl Future<Output = Result<Self::Configured, Self::Error>>;

    /// Starts without state of an earlier activation.
    ///
    /// # Errors
    /// Any error; the node stays inactive.
    fn activate(&self, configured: &Self::Configured) -> Result<Self::Active, Self::Error>;

    /// Works until the context is shut down. Deactivating drops this future at an `await`.
    ///
    /// # Errors
    /// An error that ends the node.
    fn run(
        &self,
        configured: &mut Self::Configured,
        active: &mut Self::Active,
    ) -> impl Future<Output = Result<(), Self::Error>>;
}

/// The lifecycle of one node.
pub struct Lifecycle {
    node: Node,
    machine: Arc<Mutex<Machine>>,
    changes: Service<ChangeState>,
    events: Publisher<TransitionEvent>,
    autostart: bool,
}

/// A transition in progress, and the call that requests it; `None` if the node makes it by itself.
struct TransitionRequest {
    transition: &'static Transition,
    call: Option<Call<ChangeState>>,
}

impl Lifecycle {
    /// Makes `node` a managed one: the services `~/change_state`, `~/get_state`, `~/get_available_states`,
    /// `~/get_available_transitions` and `~/get_transition_graph`, the topic `~/transition_event`, and the parameter
    /// `autostart`. To be called before [`Node::seal_parameters`].
    ///
    /// # Errors
    /// An `autostart` that is not a bool, or the middleware failed.
    pub fn new(node: &Node) -> Result<Self, Error> {
        let autostart = autostart().declare(node)?;
        let machine = Arc::new(Mutex::new(Machine::default()));
        services::serve(node, &machine)?;
        Ok(Self {
            node: node.clone(),
            machine,
            changes: node.service("~/change_state")?,
            events: node.publisher("~/transition_event", EVENTS_QOS)?,
            autostart,
        })
    }

    /// Runs the node until the context is shut down, or a call requests the transition `shutdown`.
    ///
    /// # Errors
    /// The error that ended the active node; with `autostart`, also an error of its start.
    pub async fn run<M: Managed>(mut self, managed: M) -> Result<(), M::Error> {
        let mut is_starting = self.autostart;
        'unconfigured: loop {
            self.say(State::Unconfigured);
            let by_itself = is_starting.then_some("configure");
            let Some(request) = self.request(by_itself).await else {
                return Ok(());
            };
            if request.transition.goal == State::ShuttingDown {
                return Ok(self.end(request).await?);
            }
            let gate = Gate::default();
            let configured = managed.configure(&self.node.behind(&gate)).await;
            let configured = configured.and_then(|configured| {
                self.node.seal_endpoints()?;
                Ok(configured)
            });
            let mut configured = match configured {
                Ok(configured) => configured,
                Err(error) if is_starting => return Err(error),
                Err(error) => {
                    self.fail(request, &error)?;
                    continue 'unconfigured;
                }
            };
            self.succeed(request)?;
            loop {
                self.say(State::Inactive);
                let by_itself = is_starting.then_some("activate");
                let Some(request) = self.request(by_itself).await else {
                    return Ok(());
                };
                match request.transition.goal {
                    State::ShuttingDown => return Ok(self.end(request).await?),
                    State::CleaningUp => {
                        drop(configured);
                        self.succeed(request)?;
                        continue 'unconfigured;
                    }
                    _ => {}
                }
                self.node.diagnostics().stand_down();
                let mut active = match managed.activate(&configured) {
                    Ok(active) => active,
                    Err(error) if is_starting => return Err(error),
                    Err(error) => {
                        self.fail(request, &error)?;
                        continue;
                    }
                };
                is_starting = false;
                self.node.open(&gate);
                self.say(State::Active);
                self.succeed(request)?;
                let request = {
                    let mut working = pin!(managed.run(&mut configured, &mut active));
                    tokio::select! {
                        result = &mut working => return result,
                        request = self.request(None) => request,
                    }
                };
                gate.close();
                let Some(request) = request else {
                    return Ok(());
                };
                drop(active);
                self.node.diagnostics().stand_down();
                if request.transition.goal == State::ShuttingDown {
                    return Ok(self.end(request).await?);
                }
                self.succeed(request)?;
            }
        }
    }

    /// Begins the transition of this label, or waits for a call that requests one. Impossible transitions are refused. `None`
    /// once the context is shut down.
    async fn request(&mut self, by_itself: Option<&str>) -> Option<TransitionRequest> {
        if let Some(label) = by_itself
            && let Ok(transition) = self.begin(0, label)
        {
            let call = None;
            return Some(TransitionRequest { transition, call });
        }
        loop {
            let call = self.changes.recv().await?;
            let wanted = &call.request.transition;
            match self.begin(wanted.id, &wanted.label) {
                Ok(transition) => {
                    let call = Some(call);
                    return Some(TransitionRequest { transition, call });
                }
                Err(refused) => {
                    tracing::warn!("change_state: {refused}");
                    answer(call, false);
                }
            }
        }
    }

    fn begin(&self, id: u8, label: &str) -> Result<&'static Transition, Refused> {
        let transition = self.machine().begin(id, label)?;
        tracing::debug!("{}", transition.goal.label());
        if let Err(error) = self.announce(transition) {
            tracing::warn!("cannot publish a lifecycle transition: {error}");
        }
        Ok(transition)
    }

    fn succeed(&self, request: TransitionRequest) -> Result<(), Error> {
        self.finish(request, Outcome::Success)
    }

    fn fail(&self, request: TransitionRequest, error: &dyn Display) -> Result<(), Error> {
        tracing::error!("{}: {error:#}", request.transition.label);
        self.finish(request, Outcome::Failure)
    }

    fn finish(&self, request: TransitionRequest, outcome: Outcome) -> Result<(), Error> {
        let made = self.machine().finish(outcome);
        if let Some(transition) = made {
            self.announce(transition)?;
        }
        if let Some(call) = request.call {
            answer(call, outcome == Outcome::Success);
        }
        Ok(())
    }

    /// Ends the node after its subscribers have acknowledged the last transition.
    async fn end(&self, request: TransitionRequest) -> Result<(), Error> {
        tracing::info!("shut down by ~/change_state");
        self.succeed(request)?;
        self.events.wait_for_acknowledgments(FAREWELL).await?;
        self.changes.wait_for_acknowledgments(FAREWELL).await?;
        Ok(())
    }

    fn announce(&self, transition: &Transition) -> Result<(), Error> {
        self.events.publish(&TransitionEvent {
            // Times before 1970 have no such number.
            timestamp: u64::try_from(self.node.now().to_nanos()).unwrap_or(0),
            transition: transition.message(),
            start_state: transition.start.message(),
            goal_state: transition.goal.message(),
        })
    }

    /// On `/diagnostics`.
    fn say(&self, state: State) {
        let text = match state {
            State::Active => "running",
            state => state.label(),
        };
        self.node.diagnostics().set_status(Level::Ok, text);
    }

    /// No invariant spans the lock.
    fn machine(&self) -> MutexGuard<'_, Machine> {
        self.machine.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The parameter of every managed node.
pub(crate) fn autostart() -> ParameterSpec {
    let text =
        "Whether the node configures and activates itself. If false, it waits for ~/change_state.";
    ParameterSpec::of::<bool>("autostart", text, true)
}

fn answer(call: Call<ChangeState>, success: bool) {
    if let Err(error) = call.respond(&ChangeStateResponse { success }) {
        tracing::warn!("cannot answer change_state: {error}");
    }
}
