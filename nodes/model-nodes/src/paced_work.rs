//! Heavy computation on every nth input, for work that is slower than its input.

use std::time::{Duration, Instant};

use tokio::task::JoinError;

use crate::{
    cadence::{Cadence, Load, Verdict},
    work::{Stop, Work},
};

/// What happened to an input.
#[derive(Debug)]
pub(crate) enum Offered<T> {
    /// It is accepted: the work runs, or waits.
    Taken,
    /// It, or one that waited, is skipped.
    Skipped,
    /// One that waited is dropped: its work was due.
    Late(T),
}

/// [`Work`] of which one input waits at most, at a [`Cadence`].
pub(crate) struct PacedWork<T, R> {
    work: Work<T, (R, Option<Duration>)>,
    pub cadence: Cadence,
}

impl<T: Send + 'static, R: Send + 'static> PacedWork<T, R> {
    /// Work that `run` does; it returns how long that took, unless it was cancelled.
    pub fn new(
        cadence: Cadence,
        run: impl Fn(T, &Stop) -> (R, Option<Duration>) + Send + Sync + 'static,
    ) -> Self {
        Self {
            work: Work::new(1, run),
            cadence,
        }
    }

    /// Takes a new input of the stamp `stamp_ns` that arrives at `now`.
    pub fn offer(&mut self, input: T, stamp_ns: i64, now: Instant) -> Offered<T> {
        let verdict = self.cadence.arrived(stamp_ns, now, self.load());
        if verdict == Verdict::Skip {
            return Offered::Skipped;
        }
        match self.work.submit(input) {
            None => Offered::Taken,
            Some(lost) if verdict == Verdict::ReplaceLate => Offered::Late(lost),
            Some(_) => Offered::Skipped,
        }
    }

    /// Replaces the newest input by a more complete one. Work that is slower than its input ignores it.
    pub fn offer_again(&mut self, input: T) -> Offered<T> {
        if self.cadence.nth() > 1 {
            return Offered::Taken;
        }
        match self.work.submit(input) {
            None => Offered::Taken,
            Some(lost) => Offered::Late(lost),
        }
    }

    /// As [`Work::finished`].
    ///
    /// # Errors
    /// [`JoinError`] where the work panicked.
    pub async fn finished(&mut self) -> Result<R, JoinError> {
        let is_followed = self.work.waiting() > 0;
        let (result, taken) = self.work.finished().await?;
        if is_followed {
            self.cadence.begun(Instant::now());
        }
        if let Some(taken) = taken {
            self.cadence.took(taken);
        }
        Ok(result)
    }

    fn load(&self) -> Load {
        match (self.work.is_running(), self.work.waiting()) {
            (false, _) => Load::Idle,
            (true, 0) => Load::Busy,
            (true, _) => Load::Waiting,
        }
    }
}
