//! State shared by the node and the clients' tasks.

use crate::{
    access::Access,
    bag::Bag,
    command::{Command, Permission},
    cursor::Status,
    foxglove::hub::Hub,
    state::State,
    status::{self, InputTopic, View},
};
use std::sync::{
    Arc, Mutex, MutexGuard, PoisonError,
    atomic::{AtomicU64, AtomicUsize, Ordering},
};
use tokio::sync::{mpsc, watch};
use wm_ros::Clock;

/// State shared by the node and the clients' tasks.
pub(crate) struct Shared {
    known: Mutex<SharedState>,
    /// Changes when clients may have something to send.
    news: watch::Sender<u64>,
    /// Commands for the node.
    commands: mpsc::Sender<ClientCommand>,
    clients: AtomicUsize,
    refused: Arc<AtomicU64>,
    settings: Settings,
}

pub(crate) struct Settings {
    pub access: Access,
    pub permission: Permission,
    pub max_clients: usize,
    /// The first message of each client.
    pub hello: String,
    pub bag: Option<Arc<Bag>>,
    pub clock: Clock,
    /// Topics for viewers with Foxglove's protocol; `None` if the user offers none.
    pub foxglove: Option<Arc<Hub>>,
}

pub(crate) struct SharedState {
    pub state: State,
    /// The subscribed topics.
    pub inputs: Vec<InputTopic>,
    /// The last message `status`.
    pub status: Status,
}

/// A command that a client has sent.
pub(crate) struct ClientCommand {
    /// The number of its answer.
    pub number: u32,
    pub command: Command,
    /// Receives the reply.
    pub answers: mpsc::Sender<String>,
}

impl Shared {
    pub(crate) fn new(
        state: State,
        inputs: Vec<InputTopic>,
        settings: Settings,
        commands: mpsc::Sender<ClientCommand>,
    ) -> Self {
        Self {
            known: Mutex::new(SharedState {
                state,
                inputs,
                status: Status::default(),
            }),
            news: watch::Sender::new(0),
            commands,
            clients: AtomicUsize::new(0),
            refused: Arc::default(),
            settings,
        }
    }

    /// Each message leaves the state consistent, so it outlives a panic.
    pub(crate) fn known(&self) -> MutexGuard<'_, SharedState> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn wake(&self) {
        self.news.send_modify(|number| *number += 1);
    }

    /// Wakes a client.
    pub(crate) fn news(&self) -> watch::Receiver<u64> {
        self.news.subscribe()
    }

    pub(crate) fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The queue of commands for the node.
    pub(crate) fn commands(&self) -> &mpsc::Sender<ClientCommand> {
        &self.commands
    }

    /// The number of connected clients.
    pub(crate) fn clients(&self) -> usize {
        self.clients.load(Ordering::Relaxed)
    }

    /// Counts connections refused because there were too many.
    pub(crate) fn refused(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.refused)
    }

    /// Updates the message `status`.
    pub(crate) fn renew_status(&self) {
        let view = View {
            clients: self.clients(),
            refused: self.refused.load(Ordering::Relaxed),
        };
        let now_ns = self.settings.clock.now().to_nanos();
        let mut known = self.known();
        let known = &mut *known;
        known.status.message = status::message(&mut known.state, &known.inputs, &view, now_ns);
        known.status.number += 1;
    }

    /// Reserves a place for one more client; `None` if `max_clients` are connected.
    pub(crate) fn admit(self: &Arc<Self>) -> Option<ClientSlot> {
        let limit = self.settings.max_clients;
        let next = |clients: usize| (clients < limit).then_some(clients + 1);
        let order = Ordering::Relaxed;
        self.clients.fetch_update(order, order, next).ok()?;
        Some(ClientSlot(Arc::clone(self)))
    }
}

/// The place of a connected client; dropping it frees the place.
pub(crate) struct ClientSlot(Arc<Shared>);

impl Drop for ClientSlot {
    fn drop(&mut self) {
        self.0.clients.fetch_sub(1, Ordering::Relaxed);
    }
}
