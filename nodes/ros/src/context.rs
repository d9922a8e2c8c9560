//! State shared by the nodes of a process: the participant, and the thread that receives.

#[cfg(feature = "zenoh")]
use crate::zenoh::Zenoh;
use crate::{Environment, Error, Middleware, Shutdown, backend::Backend, dds::Dds};
use std::{
    sync::{Arc, Mutex, PoisonError, Weak},
    thread::JoinHandle,
    time::Duration,
};
use tokio::{runtime::Handle, sync::oneshot};

/// How often the middleware is checked for faults.
const PULSE: Duration = Duration::from_secs(1);

/// A participant in the graph and its receiving thread. Subscriptions, services, parameters, clocks and diagnostics of
/// its nodes run there, so that computing nodes do not stall them. Several nodes share one context.
#[derive(Clone)]
pub struct Context {
    inner: Arc<Inner>,
}

struct Inner {
    backend: Arc<dyn Backend>,
    runtime: Handle,
    thread: Mutex<Option<Thread>>,
    shutdown: Shutdown,
    /// The fault that ended the middleware.
    failure: Mutex<Option<Error>>,
}

struct Thread {
    stop: oneshot::Sender<()>,
    handle: JoinHandle<()>,
}

impl Context {
    /// Joins the graph.
    ///
    /// # Errors
    /// The thread cannot be started, or the middleware cannot open its sockets.
    pub fn new(environment: &Environment) -> Result<Self, Error> {
        let failed = |source| Error::io("start the receiving thread", source);
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(failed)?;
        let handle = runtime.handle().clone();
        let (stop, stopped) = oneshot::channel();
        // At the end of the thread, the runtime drops every task and its readers.
        let thread = std::thread::Builder::new()
            .name("wm_ros".to_owned())
            .spawn(move || drop(runtime.block_on(stopped)))
            .map_err(failed)?;
        let thread = Mutex::new(Some(Thread {
            stop,
            handle: thread,
        }));
        let backend = join(environment, &handle)?;
        let inner = Arc::new(Inner {
            backend,
            runtime: handle,
            thread,
            shutdown: Shutdown::new(),
            failure: Mutex::default(),
        });
        inner.runtime.spawn(watch(Arc::downgrade(&inner)));
        Ok(Self { inner })
    }

    /// The shutdown of this context, requested here or by a signal, for all its nodes.
    pub fn shutdown(&self) -> Shutdown {
        self.inner.shutdown.clone()
    }

    /// From now on SIGINT and SIGTERM end the context's subscriptions.
    ///
    /// # Errors
    /// The operating system refuses the handlers.
    pub fn listen_for_signals(&self) -> Result<(), Error> {
        let _inside = self.inner.runtime.enter();
        self.inner.shutdown.listen_for_signals()
    }

    /// Leaves the graph in order: first the readers, then the nodes' names, then the participant. Drop publishers and
    /// nodes first, so that other participants are notified of each. Remaining endpoints do nothing afterwards.
    pub fn close(&self) {
        self.inner.close();
    }

    /// The fault that ended the context; returned once.
    pub(crate) fn failure(&self) -> Option<Error> {
        self.inner.failure().take()
    }

    pub(crate) fn backend(&self) -> &Arc<dyn Backend> {
        &self.inner.backend
    }

    pub(crate) fn runtime(&self) -> &Handle {
        &self.inner.runtime
    }
}

fn join(environment: &Environment, runtime: &Handle) -> Result<Arc<dyn Backend>, Error> {
    match environment.middleware {
        Middleware::Dds => Ok(Dds::join(environment, runtime.clone())?),
        #[cfg(feature = "zenoh")]
        Middleware::Zenoh => Ok(Zenoh::join(environment, runtime.clone())?),
        #[cfg(not(feature = "zenoh"))]
        Middleware::Zenoh => Err(Error::NoZenoh),
    }
}

/// Ends the context if its middleware has failed: a node without a working middleware should end, so that its
/// supervisor restarts it.
async fn watch(inner: Weak<Inner>) {
    loop {
        tokio::time::sleep(PULSE).await;
        let Some(inner) = inner.upgrade() else { return };
        if let Some(failure) = inner.backend.failure() {
            *inner.failure() = Some(failure);
            inner.shutdown.trigger();
            return;
        }
    }
}

impl Inner {
    /// No invariant spans the lock.
    fn failure(&self) -> std::sync::MutexGuard<'_, Option<Error>> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn close(&self) {
        self.shutdown.trigger();
        let thread = self
            .thread
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let Some(Thread { stop, handle }) = thread else {
            return;
        };
        self.backend.settle();
        stop.send(()).ok();
        // A handler on the receiving thread may own the last clone; the thread cannot wait for itself.
        if handle.thread().id() != std::thread::current().id() && handle.join().is_err() {
            tracing::error!("the receiving thread ended with a panic");
        }
        self.backend.close();
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.close();
    }
}
