//! The end of a process that is asked to end while one of its calls blocks.

use crate::{Error, logging, shutdown::Signals};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};
use tokio::sync::oneshot;

/// How long a start may go on after SIGINT or SIGTERM: nothing can be lost yet.
const STARTING: Duration = Duration::from_millis(1200);
/// How long a body may block its thread after that. An orderly end takes less.
const RUNNING: Duration = Duration::from_secs(10);

/// Ends the process after SIGINT or SIGTERM even if its thread blocks in a call, such as one to a router that does not
/// answer: the runtime serves no signals then. Drop it when the process can end by itself.
pub(crate) struct Blocked {
    is_running: Arc<AtomicBool>,
    _over: oneshot::Sender<()>,
}

impl Blocked {
    /// The guard of a process that starts.
    ///
    /// # Errors
    /// The operating system refuses a thread or the handlers.
    pub(crate) fn guard() -> Result<Self, Error> {
        let is_running = Arc::new(AtomicBool::new(false));
        let (own, is_over) = oneshot::channel();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|source| Error::io("start the runtime", source))?;
        let signals = {
            let _inside = runtime.enter();
            Signals::catch()?
        };
        let shared = Arc::clone(&is_running);
        thread::Builder::new()
            .name("blocked".to_owned())
            .spawn(move || runtime.block_on(watch(signals, &shared, is_over)))
            .map_err(|source| Error::io("start a thread", source))?;
        Ok(Self {
            is_running,
            _over: own,
        })
    }

    /// The start is over, and the body runs.
    pub(crate) fn start_is_over(&self) {
        self.is_running.store(true, Ordering::Relaxed);
    }
}

/// Ends the process if it should have ended and has not.
async fn watch(signals: Signals, is_running: &AtomicBool, is_over: oneshot::Receiver<()>) {
    let late = async {
        signals.next().await;
        tokio::time::sleep(STARTING).await;
        if !is_running.load(Ordering::Relaxed) {
            tracing::warn!("ended by a signal while it still joined the graph");
            return 0;
        }
        tokio::time::sleep(RUNNING).await;
        tracing::error!("still blocked {RUNNING:?} after a signal: ended without order");
        1
    };
    let code = tokio::select! {
        code = late => code,
        _ = is_over => return,
    };
    logging::flush();
    std::process::exit(code);
}
