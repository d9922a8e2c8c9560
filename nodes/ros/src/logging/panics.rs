//! A panic ends the process, in order if possible: without this, a node whose thread or task has panicked would look
//! alive but do nothing.
//!
//! The body ends as after a signal, so that a recorder still closes its bag, and `run` returns
//! [`Error::ThreadPanicked`](crate::Error::ThreadPanicked). A process that does not end in time ends with code 101, as
//! after a panic in `main`. If a panic becomes an error of its own, as in a job of a node, that error is returned
//! instead.

use super::outlet::STDERR;
use crate::{Shutdown, shutdown::ORDERLY};
use std::{
    panic::PanicHookInfo,
    sync::{Mutex, MutexGuard, Once, PoisonError, mpsc},
    time::Duration,
};

/// How long the panicking thread waits for its record to be logged; it may own a lock that logging needs.
const LOGGED: Duration = Duration::from_millis(500);
const EXIT_CODE: i32 = 101;

static STATE: Mutex<State> = Mutex::new(State {
    shutdown: None,
    first: None,
});

struct State {
    /// The shutdown of the running node.
    shutdown: Option<Shutdown>,
    /// The first panic, as text.
    first: Option<String>,
}

/// From now on a panic in any thread triggers `shutdown` and ends the process.
pub(crate) fn end_process(shutdown: Shutdown) {
    static HOOK: Once = Once::new();
    state().shutdown = Some(shutdown);
    HOOK.call_once(|| std::panic::set_hook(Box::new(hook)));
}

/// The first panic of the process, as text.
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
    // On a thread of its own: this one may have panicked while logging, and own a lock that logging needs.
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
