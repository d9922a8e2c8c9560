//! How far a command is: a status line on a terminal, a line every ten seconds without one.
//!
//! ```
//! let progress = wm_progress::Progress::of("reading", "bags", 3);
//! for bag in ["a", "b", "c"] {
//!     assert_eq!(bag.len(), 1);
//!     progress.inc(1);
//! }
//! drop(progress); // clears the status line
//! ```
//!
//! A thread of its own tells: a single step that takes minutes is seen to go on. What is over within a moment is not told
//! at all. Everything goes to standard error, since results go to standard output.

mod line;

use line::{Counted, line};
use std::io::{IsTerminal as _, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Between two lines of a log.
const LOGGED: Duration = Duration::from_secs(10);
/// Between two looks of a status line; it begins with the second.
const SHOWN: Duration = Duration::from_millis(250);
/// Back to the line's beginning, and clears it.
const CLEAR: &str = "\r\u{1b}[2K";

/// The progress of one thing that takes a while; dropped when it is done.
pub struct Progress {
    shared: Arc<Shared>,
    ticker: Option<(Sender<()>, JoinHandle<()>)>,
}

struct Shared {
    what: String,
    things: String,
    total: Option<u64>,
    done: AtomicU64,
    /// When it began, and what had been done before.
    begun: Mutex<(Instant, u64)>,
    message: Mutex<String>,
    is_terminal: bool,
    output: Mutex<Box<dyn Write + Send>>,
}

impl Progress {
    /// Of `total` things to do: `reading`, `bags`, 12.
    #[must_use]
    pub fn of(what: &str, things: &str, total: u64) -> Self {
        Self::to_stderr(what, things, Some(total))
    }

    /// Of something whose end is not known: only that it goes on is told, and the things that were counted.
    #[must_use]
    pub fn open_ended(what: &str, things: &str) -> Self {
        Self::to_stderr(what, things, None)
    }

    fn to_stderr(what: &str, things: &str, total: Option<u64>) -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        let period = if is_terminal { SHOWN } else { LOGGED };
        Self::start(
            (what, things, total),
            is_terminal,
            period,
            Box::new(std::io::stderr()),
        )
    }

    fn start(
        (what, things, total): (&str, &str, Option<u64>),
        is_terminal: bool,
        period: Duration,
        output: Box<dyn Write + Send>,
    ) -> Self {
        let shared = Arc::new(Shared {
            what: what.to_owned(),
            things: things.to_owned(),
            total,
            done: AtomicU64::new(0),
            begun: Mutex::new((Instant::now(), 0)),
            message: Mutex::default(),
            is_terminal,
            output: Mutex::new(output),
        });
        let (stop, stopped) = mpsc::channel();
        let telling = Arc::clone(&shared);
        let tell = move || {
            while stopped.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
                telling.tell();
            }
        };
        // Without a thread there is no progress to see, and that is all.
        let thread = std::thread::Builder::new()
            .name("progress".to_owned())
            .spawn(tell)
            .ok();
        Self {
            shared,
            ticker: thread.map(|thread| (stop, thread)),
        }
    }

    /// So many more things are done.
    pub fn inc(&self, count: u64) {
        self.shared.done.fetch_add(count, Ordering::Relaxed);
    }

    /// So many things were done before this began, which took no time now.
    pub fn resume_at(&self, done: u64) {
        self.shared.done.store(done, Ordering::Relaxed);
        *held(&self.shared.begun) = (Instant::now(), done);
    }

    /// What else is to be told, until the next call.
    pub fn message(&self, text: impl Into<String>) {
        *held(&self.shared.message) = text.into();
    }

    /// Clears the status line for what `print` writes, to standard output for example.
    pub fn aside<T>(&self, print: impl FnOnce() -> T) -> T {
        let mut output = held(&self.shared.output);
        if self.shared.is_terminal {
            write!(output, "{CLEAR}").and_then(|()| output.flush()).ok();
        }
        print()
    }

    /// The time that is left, as far as the pace so far tells; none before anything is done.
    #[must_use]
    pub fn left(&self) -> Option<Duration> {
        self.shared.counted().left()
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some((stop, thread)) = self.ticker.take() {
            drop(stop);
            thread.join().ok();
        }
        if self.shared.is_terminal {
            write!(held(&self.shared.output), "{CLEAR}").ok();
        }
    }
}

impl Shared {
    fn counted(&self) -> Counted {
        let (begun, before) = *held(&self.begun);
        Counted {
            done: self.done.load(Ordering::Relaxed),
            before,
            total: self.total,
            elapsed: begun.elapsed(),
        }
    }

    fn tell(&self) {
        let message = held(&self.message).clone();
        let text = line(&self.what, &self.things, &self.counted(), &message);
        let (clear, end) = if self.is_terminal {
            (CLEAR, "")
        } else {
            ("", "\n")
        };
        let mut output = held(&self.output);
        // That nobody can be told is no reason to stop the work.
        write!(output, "{clear}{text}{end}")
            .and_then(|()| output.flush())
            .ok();
    }
}

/// No invariant spans the locks.
fn held<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// What was written, and a signal for each piece.
    struct Told(Sender<String>);

    impl Write for Told {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0
                .send(String::from_utf8_lossy(bytes).into_owned())
                .ok();
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    fn started(is_terminal: bool) -> (Progress, mpsc::Receiver<String>) {
        let (sender, told) = mpsc::channel();
        let what = ("reading", "bags", Some(4));
        let period = Duration::from_millis(1);
        (
            Progress::start(what, is_terminal, period, Box::new(Told(sender))),
            told,
        )
    }

    /// Pieces until one has all of it.
    fn until(told: &mpsc::Receiver<String>, wanted: &str) -> String {
        let mut all = String::new();
        while !all.contains(wanted) {
            all.push_str(&told.recv_timeout(Duration::from_secs(20)).unwrap());
        }
        all
    }

    #[test]
    fn a_log_gets_whole_lines_and_goes_on_without_a_step() {
        let (progress, told) = started(false);
        until(&told, "reading: 0 of 4 bags\n");
        progress.inc(3);
        progress.message("loss 0.5");
        let text = until(&told, "reading: 3 of 4 bags");
        assert!(!text.contains('\r'), "{text:?}");
        until(&told, "loss 0.5");
        drop(progress);
        // Nobody tells any more: the channel ends.
        while told.recv_timeout(Duration::from_secs(20)).is_ok() {}
    }

    #[test]
    fn a_terminal_has_one_line_which_is_cleared_at_the_end() {
        let (progress, told) = started(true);
        until(&told, "reading: 0 of 4 bags");
        assert_eq!(progress.aside(|| 7), 7);
        drop(progress);
        let rest: String = told.iter().collect();
        assert!(rest.ends_with(CLEAR), "{rest:?}");
    }
}
