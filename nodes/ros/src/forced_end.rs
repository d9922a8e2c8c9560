//! A process whose thread blocks ends after SIGINT or SIGTERM too.

use crate::{
    Error, logging,
    shutdown::{GRACE, ORDERLY, Signals},
};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
};
use tokio::sync::oneshot;

/// Ends the process after SIGINT or SIGTERM even if its thread blocks in a call, such as one to a router that does not
/// answer: the runtime serves no signals then. Drop it before an orderly end, which may take longer.
pub(crate) struct ForcedEnd {
    is_running: Arc<AtomicBool>,
    _over: oneshot::Sender<()>,
}

impl ForcedEnd {
    /// For a process that starts: after a signal it has [`GRACE`], because nothing can be lost yet.
    ///
    /// # Errors
    /// The operating system refuses a thread or the handlers.
    pub(crate) fn arm() -> Result<Self, Error> {
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
            .name("forced_end".to_owned())
            .spawn(move || runtime.block_on(watch(signals, &shared, is_over)))
            .map_err(|source| Error::io("start a thread", source))?;
        Ok(Self {
            is_running,
            _over: own,
        })
    }

    /// The body runs: after a signal it has [`ORDERLY`] as well.
    pub(crate) fn start_is_over(&self) {
        self.is_running.store(true, Ordering::Relaxed);
    }
}

/// Ends the process if it should have ended and has not.
async fn watch(signals: Signals, is_running: &AtomicBool, is_over: oneshot::Receiver<()>) {
    let late = async {
        signals.next().await;
        tokio::time::sleep(GRACE).await;
        if !is_running.load(Ordering::Relaxed) {
            tracing::warn!("ended by a signal while it still joined the graph");
            return 0;
        }
        tokio::time::sleep(ORDERLY).await;
        tracing::error!("still blocked {ORDERLY:?} after a signal: ended by force");
        1
    };
    let code = tokio::select! {
        code = late => code,
        _ = is_over => return,
    };
    logging::flush();
    std::process::exit(code);
}
