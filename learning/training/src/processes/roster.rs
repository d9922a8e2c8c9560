use std::{
    collections::BTreeMap,
    net::SocketAddr,
    sync::{Condvar, Mutex, MutexGuard, PoisonError, mpsc::SyncSender},
    time::Duration,
};

use super::{
    limits::Limits,
    message::EndState,
    order::{Offer, Order},
    shares::Pace,
    trial::Trial,
};

/// Most notices kept until they are printed; further ones are counted.
const MOST_NOTICES: usize = 20;

/// The workers of a coordinator, shared by its threads.
#[derive(Debug)]
pub struct Roster {
    /// Offer to workers.
    pub offer: Offer,
    /// Times and numbers.
    pub limits: Limits,
    state: Mutex<State>,
    changed: Condvar,
    /// Held while a share is sent.
    sending: Mutex<()>,
}

#[derive(Debug, Default)]
struct State {
    workers: BTreeMap<u64, Entry>,
    /// Key of the next worker.
    next: u64,
    /// Open connections, those of strangers included.
    connections: usize,
    end: Option<EndState>,
    notices: Vec<String>,
    /// Notices beyond [`MOST_NOTICES`].
    more_notices: u64,
}

/// A worker.
#[derive(Debug)]
pub struct Entry {
    /// Its threads.
    pub threads: usize,
    /// Address, for notices.
    pub address: SocketAddr,
    /// Orders for its thread; `None` at the end.
    pub orders: Option<SyncSender<Order>>,
    /// Speed; `None` before its first trial.
    pub pace: Option<Pace>,
    /// The trial in progress.
    pub trial: Option<Trial>,
    /// Steps since its last batch.
    pub idle_steps: u32,
    /// A verdict other than exact is printed once.
    pub is_rounding_known: bool,
}

impl Roster {
    /// No workers.
    pub fn new(offer: Offer, limits: Limits) -> Self {
        Self {
            offer,
            limits,
            state: Mutex::default(),
            changed: Condvar::new(),
            sending: Mutex::default(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until no other share is sent. A worker that does not receive delays the others by the limit of its job, as
    /// it delays the step.
    pub fn turn_to_send(&self) -> MutexGuard<'_, ()> {
        self.sending.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts a connection; `false` if there are too many, or the training ends.
    pub fn admit(&self) -> bool {
        let mut state = self.lock();
        let has_place = state.connections < self.limits.connections && state.end.is_none();
        state.connections += usize::from(has_place);
        has_place
    }

    /// Counts an ended connection.
    pub fn dismiss(&self) {
        self.lock().connections -= 1;
    }

    /// Adds a worker; returns its key.
    pub fn add(&self, address: SocketAddr, threads: usize, orders: SyncSender<Order>) -> u64 {
        let mut state = self.lock();
        let key = state.next;
        state.next += 1;
        let entry = Entry {
            threads,
            address,
            // Dropped at once if the training has ended meanwhile.
            orders: state.end.is_none().then_some(orders),
            pace: None,
            trial: None,
            idle_steps: 0,
            is_rounding_known: false,
        };
        state.workers.insert(key, entry);
        let (count, threads) = (state.workers.len(), plural(threads, "thread"));
        state.notice(format!(
            "worker {address} with {threads} joined: {}",
            plural(count, "worker")
        ));
        drop(state);
        self.changed.notify_all();
        key
    }

    /// Removes a worker.
    pub fn remove(&self, worker: u64) {
        self.lock().workers.remove(&worker);
        self.changed.notify_all();
    }

    /// Calls `with` on all workers.
    pub fn with_workers<T>(&self, with: impl FnOnce(&mut BTreeMap<u64, Entry>) -> T) -> T {
        with(&mut self.lock().workers)
    }

    /// Adds a notice for the user.
    pub fn notice(&self, notice: String) {
        self.lock().notice(notice);
        self.changed.notify_all();
    }

    /// The notices since the last call.
    pub fn take_notices(&self) -> Vec<String> {
        let mut state = self.lock();
        let mut notices = std::mem::take(&mut state.notices);
        let more = std::mem::take(&mut state.more_notices);
        if more > 0 {
            notices.push(format!("{more} further notices about workers"));
        }
        notices
    }

    /// Waits for a change, at most `limit`; returns the number of workers.
    pub fn wait(&self, limit: Duration) -> usize {
        let state = self.lock();
        let waited = self.changed.wait_timeout(state, limit);
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        state.workers.len()
    }

    /// The end of the training, if it has come.
    pub fn end(&self) -> Option<EndState> {
        self.lock().end
    }

    /// Ends the training for all workers, and waits at most `limit` until they know.
    pub fn close(&self, end: EndState, limit: Duration) {
        let mut state = self.lock();
        state.end.get_or_insert(end);
        for entry in state.workers.values_mut() {
            entry.orders = None;
        }
        let closed =
            (self.changed).wait_timeout_while(state, limit, |state| !state.workers.is_empty());
        drop(closed);
    }
}

impl State {
    fn notice(&mut self, notice: String) {
        match self.notices.len() < MOST_NOTICES {
            true => self.notices.push(notice),
            false => self.more_notices += 1,
        }
    }
}

/// `1 worker`, `2 workers`.
pub fn plural(count: usize, thing: &str) -> String {
    let s = if count == 1 { "" } else { "s" };
    format!("{count} {thing}{s}")
}
