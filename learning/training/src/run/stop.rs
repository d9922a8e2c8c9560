use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use anyhow::{Context as _, Result};

/// Whether a run is to end. Clones share one answer.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Asked for by SIGINT, SIGTERM or SIGHUP; a second one ends the process at once.
    ///
    /// # Errors
    /// If the handler cannot be set, or there is one already.
    pub fn on_signals() -> Result<Self> {
        let stop = Self::default();
        let of_handler = stop.clone();
        ctrlc::set_handler(move || {
            if of_handler.0.swap(true, Ordering::SeqCst) {
                // As a shell reports a process that SIGINT ended.
                std::process::exit(130);
            }
            eprintln!(
                "\nfinishes the step, saves, and writes the model as it is; once more to end at once"
            );
        })
        .context("the handler of SIGINT and SIGTERM")?;
        Ok(stop)
    }

    /// Asks for the end.
    pub fn ask(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Whether it was asked for.
    #[must_use]
    pub fn is_asked(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}
