//! A panic ends the process, in order where it can: a thread or task that ends silently leaves a node that looks alive
//! but does nothing.
//!
//! The body is asked to end as by a signal, so that a recorder still closes its bag, and `run` returns
//! [`Error::ThreadPanicked`](crate::Error::ThreadPanicked). A process that does not end in time ends with code 101, which is that of
//! a panic in `main`. Where a panic becomes an error of its own, as in a job of a node, that error is returned instead.

use super::outlet::STDERR;
use crate::Shutdown;
use std::{
    panic::PanicHookInfo,
    sync::{Mutex, MutexGuard, Once, PoisonError, mpsc},
    time::Duration,
};

/// How long the process may take to end in order.
const ORDERLY: Duration = Duration::from_secs(10);
/// How long the panicking thread waits for its record to be logged; it may hold what logging needs.
const LOGGED: Duration = Duration::from_millis(500);
const EXIT_CODE: i32 = 101;

static STATE: Mutex<State> = Mutex::new(State {
    shutdown: None,
    first: None,
});

struct State {
    /// What ends the node that runs.
    shutdown: Option<Shutdown>,
    /// The first panic, in words.
    first: Option<String>,
}

/// From now on a panic in any thread ends the process, and asks `shutdown` first.
pub(crate) fn end_process(shutdown: Shutdown) {
    static HOOK: Once = Once::new();
    state().shutdown = Some(shutdown);
    HOOK.call_once(|| std::panic::set_hook(Box::new(hook)));
}

/// The first panic of the process, in words.
pub(crate) fn first() -> Option<String> {
    state().first.clone()
}

fn hook(info: &PanicHookInfo<'_>) {
    let thread = std::thread::current();
    let place = info.location().map(ToString::to_string).unwrap_or_default();
    let text = format!(
        "thread `{}` panicked at {place}: {}",
        thread.name().unwrap_or("unnamed"),
        message(info).unwrap_or("no message")
    );
    let shutdown = {
        let mut state = state();
        state.first.get_or_insert_with(|| text.clone());
        state.shutdown.clone()
    };
    // On a thread of its own: this one may have panicked while it logged, and hold what logging needs.
    let (logged, is_logged) = mpsc::channel();
    let in_order = {
        let text = text.clone();
        std::thread::Builder::new().spawn(move || {
            tracing::error!("{text}; the process ends");
            logged.send(()).ok();
            if let Some(shutdown) = shutdown {
                shutdown.trigger();
            }
            std::thread::sleep(ORDERLY);
            exit();
        })
    };
    if is_logged.recv_timeout(LOGGED).is_err() {
        STDERR
            .push(format!("{text}; the process ends\n").into_bytes())
            .ok();
    }
    if in_order.is_err() {
        exit();
    }
}

fn message<'a>(info: &'a PanicHookInfo<'_>) -> Option<&'a str> {
    let payload = info.payload();
    let text = payload.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| payload.downcast_ref::<&str>().copied())
}

fn exit() -> ! {
    super::flush();
    std::process::exit(EXIT_CODE)
}

fn state() -> MutexGuard<'static, State> {
    STATE.lock().unwrap_or_else(PoisonError::into_inner)
}
