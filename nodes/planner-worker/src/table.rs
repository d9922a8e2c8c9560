//! What the search and the workers share: the batches of a population.

use std::{
    collections::BTreeMap,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tokio::{sync::watch, task::AbortHandle};
use wm_planner::{Batch, WorkerCounts};

use crate::{
    dispatch::{Dispatch, Job, ReturnReason},
    message::EncodedFunction,
};

/// State shared by the search and the members of the pool.
pub(crate) struct Table {
    pub(crate) state: Mutex<State>,
    /// The state has changed.
    pub(crate) changed: Condvar,
    /// A batch is available.
    pub(crate) open: watch::Sender<()>,
}

#[derive(Default)]
pub(crate) struct State {
    pub(crate) dispatch: Dispatch,
    /// The current population.
    pub(crate) round: Option<Arc<Round>>,
    /// Whether a plan has the workers.
    pub(crate) is_lent: bool,
    /// The workers by their keys.
    pub(crate) members: BTreeMap<String, AbortHandle>,
}

/// A population and its cost function.
pub(crate) struct Round {
    pub(crate) function: Arc<EncodedFunction>,
    pub(crate) batches: Arc<[Batch]>,
}

impl Table {
    pub(crate) fn new() -> Self {
        Self {
            state: Mutex::default(),
            changed: Condvar::new(),
            open: watch::Sender::new(()),
        }
    }

    /// A panic of another thread breaks no invariant of the table.
    pub(crate) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the counters.
    pub(crate) fn count(&self, change: impl FnOnce(&mut WorkerCounts)) {
        change(&mut self.lock().dispatch.counts);
        self.changed.notify_all();
    }

    /// Waits for a batch to cost. Cancel safe.
    pub(crate) async fn take(self: &Arc<Self>) -> Lease {
        let mut open = self.open.subscribe();
        loop {
            open.borrow_and_update();
            if let Some(lease) = self.try_take() {
                return lease;
            }
            // The sender lives as long as this table.
            let _ = open.changed().await;
        }
    }

    fn try_take(self: &Arc<Self>) -> Option<Lease> {
        let mut state = self.lock();
        let round = Arc::clone(state.round.as_ref()?);
        let job = state.dispatch.take(Instant::now())?;
        Some(Lease {
            patience: state.dispatch.patience(),
            table: Arc::clone(self),
            round,
            job: Some(job),
        })
    }

    fn settle(&self, change: impl FnOnce(&mut Dispatch)) {
        change(&mut self.lock().dispatch);
        self.changed.notify_all();
        self.open.send_replace(());
    }
}

/// A batch of a worker; returned when dropped without an answer.
pub(crate) struct Lease {
    pub(crate) round: Arc<Round>,
    /// How long to wait for the worker.
    pub(crate) patience: Duration,
    table: Arc<Table>,
    job: Option<Job>,
}

impl Lease {
    /// The candidates to cost.
    pub(crate) fn batch(&self) -> &[Vec<f32>] {
        let index = self.job.map(|job| job.index);
        let batch = index.and_then(|index| self.round.batches.get(index));
        batch.map_or(&[], Vec::as_slice)
    }

    pub(crate) fn answered(mut self, costs: wm_planner::Costs) {
        if let Some(job) = self.job.take() {
            self.table.settle(|dispatch| dispatch.answered(job, costs));
        }
    }

    pub(crate) fn returned(mut self, why: ReturnReason) {
        self.give_back(why);
    }

    fn give_back(&mut self, why: ReturnReason) {
        if let Some(job) = self.job.take() {
            self.table.settle(|dispatch| dispatch.returned(job, why));
        }
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        self.give_back(ReturnReason::Gone);
    }
}
