//! Permanent failures of a participant: a task panicked, the wall clock was set back, or rustdds ended.

use super::workarounds::wall_clock::WallClock;
use crate::{Error, clock::system_nanos, lock::lock};
use futures::FutureExt as _;
use std::{
    any::Any,
    panic::AssertUnwindSafe,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};
use tokio::{runtime::Handle, task::AbortHandle};

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
    /// Runs `future` on `runtime`. A panic in it becomes the participant's failure.
    pub(super) fn watch(
        self: &Arc<Self>,
        runtime: &Handle,
        task: &'static str,
        future: impl Future<Output = ()> + Send + 'static,
    ) -> AbortHandle {
        let failure = Arc::clone(self);
        let watched = async move {
            // the participant ends, so nothing uses the state that the task shared
            if let Err(panic) = AssertUnwindSafe(future).catch_unwind().await {
                let message = message_of(&*panic).to_owned();
                lock(&failure.first).get_or_insert(Cause::Panic { task, message });
            }
        };
        runtime.spawn(watched).abort_handle()
    }

    /// The first failure so far. `includes_clock`: whether a wall clock that was set back since the last call is a
    /// failure.
    pub(super) fn check(&self, includes_clock: bool) -> Option<Error> {
        let now = (Instant::now(), system_nanos());
        let step = lock(&self.clock)
            .get_or_insert(WallClock::new(now))
            .step(now);
        let mut first = lock(&self.first);
        if let Some(step) = step.filter(|_| includes_clock) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn panic_in_task_is_a_lasting_failure() {
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
