use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use anyhow::{Context as _, Result};

/// A request to end a run; clones share it.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Set by SIGINT, SIGTERM or SIGHUP, which prints `then`, what follows; a second signal ends the process at once.
    ///
    /// # Errors
    /// If the handler cannot be set, or exists already.
    pub fn on_signals(then: &'static str) -> Result<Self> {
        let stop = Self::default();
        let of_handler = stop.clone();
        ctrlc::set_handler(move || {
            if of_handler.0.swap(true, Ordering::SeqCst) {
                // Exit code of a process ended by SIGINT, as in a shell.
                std::process::exit(130);
            }
            eprintln!("\n{then}; once more to end at once");
        })
        .context("the handler of SIGINT and SIGTERM")?;
        Ok(stop)
    }

    /// Requests the end.
    pub fn ask(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Whether the end is requested.
    #[must_use]
    pub fn is_asked(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}
