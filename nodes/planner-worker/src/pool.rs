//! The workers of a planner.

use std::{
    fmt,
    path::Path,
    sync::{Arc, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, anyhow};
use tokio::runtime::{Builder, Runtime};
use wm_model::WorldModel;
use wm_planner::{
    Batch, CostFunction, Objective, SearchSpace, TransitionDynamics, Turn, WorkerCounts,
    WorkerPool, Workers,
};
use wm_ros::zenoh::{Mode, NetworkArguments};
use zenoh::{
    Session,
    pubsub::Subscriber,
    sample::{Sample, SampleKind},
};

use crate::{
    Identity, WORKERS,
    dispatch::Next,
    member,
    message::EncodedFunction,
    table::{Round, Table},
};

/// The most workers: a limit on the resources that unknown peers can take.
const MOST_WORKERS: usize = 256;
/// Messages are small and few.
const THREADS: usize = 1;
/// Longest wait for the end of threads.
const GRACE: Duration = Duration::from_millis(200);

/// The workers for a planner with this model at Zenoh endpoints, with Zenoh's configuration file if given.
///
/// # Errors
/// See [`PlannerWorkers::connect`]; or the model fails.
pub fn connect(
    model: &WorldModel,
    endpoints: &[String],
    config: Option<&Path>,
) -> Result<Arc<dyn WorkerPool>> {
    let network = NetworkArguments {
        config: config.map(Path::to_path_buf),
        // This session forwards nothing.
        mode: Some(Mode::Peer),
        connect: endpoints.to_vec(),
        ..NetworkArguments::default()
    };
    let workers = PlannerWorkers::connect(&network, Identity::of(model)?)?;
    Ok(Arc::new(workers))
}

/// The planner workers on a Zenoh network.
pub struct PlannerWorkers {
    table: Arc<Table>,
    /// `None` after the end.
    connection: Option<Connection>,
}

struct Connection {
    runtime: Runtime,
    session: Session,
    subscriber: Subscriber<()>,
}

impl fmt::Debug for PlannerWorkers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PlannerWorkers")
            .field("counts", &self.table.lock().dispatch.counts)
            .finish_non_exhaustive()
    }
}

impl PlannerWorkers {
    /// Joins the network, and finds the workers on it with the planner's `identity`.
    ///
    /// # Errors
    /// The configuration is wrong, or an endpoint cannot be listened on.
    pub fn connect(network: &NetworkArguments, identity: Identity) -> Result<Self> {
        let config = network.resolve()?;
        let table = Arc::new(Table::new());
        let found = Arc::clone(&table);
        // Some Zenoh calls block on a runtime, which fails in the caller's runtime.
        let connection = apart(move || {
            let runtime = Builder::new_multi_thread()
                .worker_threads(THREADS)
                .thread_name("planner-workers")
                .enable_all()
                .build()?;
            let handle = runtime.handle().clone();
            let (session, subscriber) = runtime.block_on(async {
                let session = wm_ros::zenoh::open(config).await?;
                let identity = Arc::new(identity);
                let own = session.clone();
                let subscriber = session
                    .liveliness()
                    .declare_subscriber(format!("{WORKERS}/*"))
                    .history(true)
                    .callback(move |sample| follow(&found, &own, &identity, &handle, &sample))
                    .await
                    .map_err(|error| anyhow!("cannot look for workers: {error}"))?;
                anyhow::Ok((session, subscriber))
            })?;
            anyhow::Ok(Connection {
                runtime,
                session,
                subscriber,
            })
        })?;
        Ok(Self {
            table,
            connection: Some(connection),
        })
    }

    /// Waits until `is_reached` holds for the counts, at most `limit`; returns the counts.
    pub fn wait_until(
        &self,
        limit: Duration,
        mut is_reached: impl FnMut(&WorkerCounts) -> bool,
    ) -> WorkerCounts {
        let state = self.table.lock();
        let waited = self
            .table
            .changed
            .wait_timeout_while(state, limit, |state| !is_reached(&state.dispatch.counts));
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        state.dispatch.counts
    }
}

/// Handles a change of a worker's liveliness token.
fn follow(
    table: &Arc<Table>,
    session: &Session,
    identity: &Arc<Identity>,
    runtime: &tokio::runtime::Handle,
    sample: &Sample,
) {
    let key = sample.key_expr().as_str();
    let mut state = table.lock();
    match sample.kind() {
        SampleKind::Put if state.members.contains_key(key) => {}
        SampleKind::Put if state.members.len() >= MOST_WORKERS => {
            tracing::warn!("planner workers beyond {MOST_WORKERS} are ignored: {key}");
        }
        SampleKind::Put => {
            let (table, session) = (Arc::clone(table), session.clone());
            let member = member::run(table, session, key.to_owned(), Arc::clone(identity));
            let task = runtime.spawn(member).abort_handle();
            state.members.insert(key.to_owned(), task);
        }
        SampleKind::Delete => {
            if let Some(member) = state.members.remove(key) {
                tracing::info!("the planner worker {key} has left");
                member.abort();
                state.dispatch.counts.gone += 1;
            }
        }
    }
    drop(state);
    table.changed.notify_all();
}

/// Runs the network on a separate thread.
fn apart<T: Send>(work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    std::thread::scope(|scope| {
        let joined = scope.spawn(work).join();
        joined.map_err(|_| anyhow!("a thread of the planner workers failed"))?
    })
    .context("planner workers")
}

impl Drop for PlannerWorkers {
    fn drop(&mut self) {
        let members = std::mem::take(&mut self.table.lock().members);
        for member in members.values() {
            member.abort();
        }
        let Some(connection) = self.connection.take() else {
            return;
        };
        let Connection {
            runtime,
            session,
            subscriber,
        } = connection;
        let closed = apart(move || {
            let closed = runtime.block_on(async {
                drop(subscriber);
                session.close().await
            });
            runtime.shutdown_timeout(GRACE);
            closed.map_err(|error| anyhow!("{error}"))
        });
        if let Err(error) = closed {
            tracing::debug!("the Zenoh session did not close: {error:#}");
        }
    }
}

impl WorkerPool for PlannerWorkers {
    fn share(
        &self,
        dynamics: &TransitionDynamics<'_>,
        objective: &Objective,
        space: &SearchSpace,
        horizon: usize,
    ) -> Option<Box<dyn Workers>> {
        {
            let mut state = self.table.lock();
            if state.is_lent || state.dispatch.counts.taking_part == 0 {
                return None;
            }
            state.is_lent = true;
        }
        // Dropping the loan returns the workers.
        let mut lent = WorkerLoan {
            table: Arc::clone(&self.table),
            function: None,
        };
        let function = CostFunction::of(dynamics, objective, space, horizon)
            .map_err(anyhow::Error::from)
            .and_then(|function| Ok(EncodedFunction::of(&function)?));
        match function {
            Ok(function) => lent.function = Some(Arc::new(function)),
            Err(error) => {
                let mut is_first = false;
                self.table.count(|counts| {
                    is_first = counts.unshared == 0;
                    counts.unshared += 1;
                });
                if is_first {
                    tracing::warn!("planning without the workers: {error:#}");
                }
                return None;
            }
        }
        Some(Box::new(lent))
    }

    fn counts(&self) -> WorkerCounts {
        self.table.lock().dispatch.counts
    }
}

/// The loan of the workers to a plan.
struct WorkerLoan {
    table: Arc<Table>,
    function: Option<Arc<EncodedFunction>>,
}

impl Workers for WorkerLoan {
    fn offer(&mut self, batches: &Arc<[Batch]>) {
        let round = self.function.as_ref().map(|function| Round {
            function: Arc::clone(function),
            batches: Arc::clone(batches),
        });
        let mut state = self.table.lock();
        state.dispatch.begin(batches.len());
        state.round = round.map(Arc::new);
        drop(state);
        self.table.open.send_replace(());
    }

    fn next(&mut self) -> Option<Turn> {
        let mut state = self.table.lock();
        loop {
            let limit = match state.dispatch.next(Instant::now()) {
                Next::Turn(turn) => return Some(turn),
                Next::Over => return None,
                Next::Wait(limit) => limit,
            };
            let waited = self.table.changed.wait_timeout(state, limit);
            (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn withdraw(&mut self) {
        let mut state = self.table.lock();
        state.dispatch.end();
        state.round = None;
    }
}

impl Drop for WorkerLoan {
    fn drop(&mut self) {
        self.withdraw();
        self.table.lock().is_lent = false;
    }
}
