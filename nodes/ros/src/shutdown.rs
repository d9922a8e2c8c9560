//! The end of a process, asked for by a signal or by the program.

use crate::Error;
use std::sync::Arc;
use tokio::sync::watch;

/// A handle on the end: any clone may ask for it, every clone sees it.
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

    /// Asks for the end.
    pub fn trigger(&self) {
        self.requested.send_replace(true);
    }

    /// Whether the end was asked for.
    pub fn is_triggered(&self) -> bool {
        *self.requested.borrow()
    }

    /// Waits until the end is asked for.
    pub async fn wait(&self) {
        // The sender lives in `self`, so the channel cannot close.
        self.requested
            .subscribe()
            .wait_for(|requested| *requested)
            .await
            .ok();
    }

    /// From now on SIGINT and SIGTERM ask for the end. Call it inside a tokio runtime, which serves the signals.
    ///
    /// # Errors
    /// The operating system refuses the handlers.
    pub fn listen_for_signals(&self) -> Result<(), Error> {
        use tokio::signal::unix::{SignalKind, signal};
        let install = |kind| signal(kind).map_err(|source| Error::io("listen for signals", source));
        let (mut interrupt, mut terminate) = (
            install(SignalKind::interrupt())?,
            install(SignalKind::terminate())?,
        );
        let shutdown = self.clone();
        tokio::spawn(async move {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
            shutdown.trigger();
        });
        Ok(())
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
