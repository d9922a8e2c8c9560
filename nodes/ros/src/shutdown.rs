//! The end of a process, requested by a signal or by the program.

use crate::Error;
use std::{sync::Arc, time::Duration};
use tokio::{
    signal::unix::{Signal, SignalKind, signal},
    sync::watch,
};

/// How long a body may take to return after SIGINT or SIGTERM, so that the process ends within 2 s.
pub(crate) const GRACE: Duration = Duration::from_millis(1200);
/// How long a process may take to end in order after a fault. It is then ended by force.
pub(crate) const ORDERLY: Duration = Duration::from_secs(10);

/// A handle of the shutdown: any clone can request it, and all clones receive it.
#[derive(Clone, Debug)]
pub struct Shutdown {
    requested: Arc<watch::Sender<bool>>,
}

impl Shutdown {
    pub(crate) fn new() -> Self {
        Self {
            requested: Arc::new(watch::Sender::new(false)),
        }
    }

    /// Requests the end.
    pub fn trigger(&self) {
        self.requested.send_replace(true);
    }

    /// Whether the end was requested.
    pub fn is_triggered(&self) -> bool {
        *self.requested.borrow()
    }

    /// Waits until the end is requested.
    pub async fn wait(&self) {
        // The sender lives in `self`, so the channel cannot close.
        self.requested
            .subscribe()
            .wait_for(|requested| *requested)
            .await
            .ok();
    }

    /// From now on SIGINT and SIGTERM request the end. Call it inside a tokio runtime, which serves the signals.
    ///
    /// # Errors
    /// The operating system refuses the handlers.
    pub fn listen_for_signals(&self) -> Result<(), Error> {
        Signals::catch()?.ask(self);
        Ok(())
    }
}

/// SIGINT and SIGTERM no longer end the process by themselves: early signals are kept until [`Shutdown`] can receive
/// them. Otherwise a process that gets a signal during its start would look like a failed one.
pub(crate) struct Signals {
    interrupt: Signal,
    terminate: Signal,
}

impl Signals {
    /// Call it inside a tokio runtime.
    ///
    /// # Errors
    /// The operating system refuses the handlers.
    pub(crate) fn catch() -> Result<Self, Error> {
        let install = |kind| signal(kind).map_err(|source| Error::io("listen for signals", source));
        Ok(Self {
            interrupt: install(SignalKind::interrupt())?,
            terminate: install(SignalKind::terminate())?,
        })
    }

    /// Connects them to the shutdown. Call it inside the same runtime.
    pub(crate) fn ask(self, shutdown: &Shutdown) {
        let shutdown = shutdown.clone();
        tokio::spawn(async move {
            self.next().await;
            shutdown.trigger();
        });
    }

    /// Waits for the first of them.
    pub(crate) async fn next(mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(flavor = "current_thread")]
    async fn every_clone_sees_the_end() {
        let shutdown = Shutdown::new();
        let waiting = tokio::spawn({
            let shutdown = shutdown.clone();
            async move { shutdown.wait().await }
        });
        assert!(!shutdown.is_triggered());
        shutdown.clone().trigger();
        waiting.await.unwrap();
        assert!(shutdown.is_triggered());
        shutdown.wait().await;
    }
}
