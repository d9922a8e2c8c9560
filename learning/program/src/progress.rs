//! How far a command is: a status line on a terminal, a line every ten seconds without one.
//!
//! ```
//! let progress = crate::progress::Progress::of("reading", "bags", 3);
//! for bag in ["a", "b", "c"] {
//!     assert_eq!(bag.len(), 1);
//!     progress.inc(1);
//! }
//! drop(progress); // clears the status line
//! ```
//!
//! A thread of its own tells: a single step that takes minutes is seen to go on. Everything goes to standard error, since
//! results go to standard output.

mod log;
mod pace;

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use log::Log;
use pace::Pace;
use std::fmt::Write;
use std::io::IsTerminal as _;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Between two lines of a log.
const LOGGED: Duration = Duration::from_secs(10);
/// Between two looks of a status line.
const SHOWN: Duration = Duration::from_millis(250);

/// The progress of one thing that takes a while; dropped when it is done.
pub struct Progress {
    bar: ProgressBar,
    pace: SharedPace,
    /// Without a terminal.
    _log: Option<Log>,
}

impl Progress {
    /// Of `total` things to do: `reading`, `bags`, 12. Things called `bytes` are told as MiB.
    #[must_use]
    pub fn of(what: &str, things: &'static str, total: u64) -> Self {
        Self::to_stderr(what, things, Some(total))
    }

    /// Of something whose end is not known: only that it goes on is told, and the things that were counted.
    #[must_use]
    pub fn open_ended(what: &str, things: &'static str) -> Self {
        Self::to_stderr(what, things, None)
    }

    fn to_stderr(what: &str, things: &'static str, total: Option<u64>) -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        let target = match is_terminal {
            true => ProgressDrawTarget::stderr(),
            false => ProgressDrawTarget::hidden(),
        };
        let bar = ProgressBar::with_draw_target(total, target).with_prefix(what.to_owned());
        let pace = SharedPace::default();
        let log = match is_terminal {
            true => {
                bar.set_style(style(things, total, pace.clone()));
                bar.enable_steady_tick(SHOWN);
                None
            }
            false => {
                let stderr = Box::new(std::io::stderr());
                Log::start(bar.clone(), pace.clone(), things, LOGGED, stderr)
            }
        };
        Self {
            bar,
            pace,
            _log: log,
        }
    }

    /// So many more things are done.
    pub fn inc(&self, count: u64) {
        self.pace.get().step(count, Instant::now());
        self.bar.inc(count);
    }

    /// So many things were done before this began, which took no time now.
    pub fn resume_at(&self, done: u64) {
        *self.pace.get() = Pace::new(done, Instant::now());
        self.bar.set_position(done);
    }

    /// What else is to be told, until the next call.
    pub fn message(&self, text: impl Into<String>) {
        self.bar.set_message(text.into());
    }

    /// Clears the status line for what `print` writes, to standard output for example.
    pub fn aside<T>(&self, print: impl FnOnce() -> T) -> T {
        self.bar.suspend(print)
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// What those who work and those who tell of it know.
#[derive(Clone)]
struct SharedPace(Arc<Mutex<Pace>>);

impl Default for SharedPace {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(Pace::new(0, Instant::now()))))
    }
}

impl SharedPace {
    /// No invariant spans the lock.
    fn get(&self) -> MutexGuard<'_, Pace> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// `, 40s left`, or nothing where that is not known.
    fn in_words(&self, total: Option<u64>) -> String {
        let left = total.and_then(|total| self.get().left(total, Instant::now()));
        left.map_or_else(String::new, |left| {
            format!(", {:#} left", HumanDuration(left))
        })
    }
}

fn style(things: &str, total: Option<u64>, pace: SharedPace) -> ProgressStyle {
    let template = match (things, total) {
        ("bytes", Some(_)) => {
            "{prefix}: {binary_bytes} of {binary_total_bytes}{left} {msg}".to_owned()
        }
        ("bytes", None) => "{prefix}: {binary_bytes}, {elapsed} so far {msg}".to_owned(),
        (_, Some(_)) => {
            format!("{{prefix}}: {{human_pos}} of {{human_len}} {things}{{left}} {{msg}}")
        }
        (_, None) => "{prefix}, {elapsed} so far {msg}".to_owned(),
    };
    let left = move |state: &ProgressState, text: &mut dyn Write| {
        // A line that cannot be written is told the next time.
        text.write_str(&pace.in_words(state.len())).ok();
    };
    ProgressStyle::with_template(&template)
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .with_key("left", left)
}
