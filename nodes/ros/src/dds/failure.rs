//! What ends a participant permanently: a task that panicked, a wall clock that was set back, or rustdds' own end.

use super::lock::lock;
use crate::{Error, clock::system_nanos};
use futures::FutureExt as _;
use std::{
    any::Any,
    panic::AssertUnwindSafe,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};
use tokio::{runtime::Handle, task::AbortHandle};

/// Best-effort readers miss what comes within the time that a step back repeats; less than this passes for loss.
const TOLERATED_STEP: Duration = Duration::from_millis(500);

/// The first failure of a participant.
#[derive(Default)]
pub(super) struct Failure {
    first: Mutex<Option<Cause>>,
    clock: Mutex<Option<WallClock>>,
}

#[derive(Clone, Debug, PartialEq)]
enum Cause {
    Panic { task: &'static str, message: String },
    ClockStep(Duration),
}

impl Failure {
    /// Runs `future` on `runtime`. A panic in it does not pass unnoticed: it is the participant's failure.
    pub(super) fn watch(
        self: &Arc<Self>,
        runtime: &Handle,
        task: &'static str,
        future: impl Future<Output = ()> + Send + 'static,
    ) -> AbortHandle {
        let failure = Arc::clone(self);
        let watched = async move {
            // what the task shared is not used any more: the participant ends
            if let Err(panic) = AssertUnwindSafe(future).catch_unwind().await {
                let message = message_of(&*panic).to_owned();
                lock(&failure.first).get_or_insert(Cause::Panic { task, message });
            }
        };
        runtime.spawn(watched).abort_handle()
    }

    /// What has failed so far. `minds_clock`: whether it is a failure that the wall clock was set back since the last
    /// call.
    pub(super) fn check(&self, minds_clock: bool) -> Option<Error> {
        let now = (Instant::now(), system_nanos());
        let step = lock(&self.clock)
            .get_or_insert(WallClock::at(now))
            .step(now);
        let mut first = lock(&self.first);
        if let Some(step) = step.filter(|_| minds_clock) {
            first.get_or_insert(Cause::ClockStep(step));
        }
        Some(match first.clone()? {
            Cause::Panic { task, message } => Error::Panicked { task, message },
            Cause::ClockStep(by) => Error::ClockStepped { by },
        })
    }
}

fn message_of(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message")
}

/// Compares the wall clock with the monotonic one.
struct WallClock {
    last: (Instant, i64),
}

impl WallClock {
    const fn at(now: (Instant, i64)) -> Self {
        Self { last: now }
    }

    /// How far the wall clock was set back since the last time, where that is too far.
    fn step(&mut self, now: (Instant, i64)) -> Option<Duration> {
        let passed = now.0.saturating_duration_since(self.last.0).as_nanos();
        let expected = i128::from(self.last.1) + i128::try_from(passed).unwrap_or(i128::MAX);
        self.last = now;
        let back = u64::try_from(expected - i128::from(now.1)).ok()?;
        let back = Duration::from_nanos(back);
        (back > TOLERATED_STEP).then_some(back)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_step_back_is_a_failure() {
        const SECOND: i64 = 1_000_000_000;
        let start = Instant::now();
        let mut clock = WallClock::at((start, 100 * SECOND));
        let mut step =
            |after: u64, says: i64| clock.step((start + Duration::from_secs(after), says));
        assert_eq!(step(1, 101 * SECOND), None);
        assert_eq!(step(2, 900 * SECOND), None, "forward");
        assert_eq!(step(3, 901 * SECOND - SECOND / 10), None, "slewed");
        let thirty = Duration::from_millis(30_900);
        assert_eq!(step(4, 871 * SECOND), Some(thirty));
        assert_eq!(step(5, 872 * SECOND), None, "said once");
    }

    #[tokio::test]
    async fn a_panic_is_a_failure_and_stays_one() {
        let failure = Arc::new(Failure::default());
        assert!(failure.check(true).is_none());
        let task = failure.watch(&Handle::current(), "test task", async {
            panic!("on purpose")
        });
        while !task.is_finished() {
            tokio::task::yield_now().await;
        }
        for _ in 0..2 {
            let error = failure.check(true).unwrap().to_string();
            assert!(
                error.contains("test task") && error.contains("on purpose"),
                "{error}"
            );
        }
    }
}
