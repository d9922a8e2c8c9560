//! Progress of a command: a status line on a terminal, otherwise a line every ten seconds.
//!
//! ```
//! let progress = wm_program::progress::Progress::of("reading", "bags", 3);
//! for bag in ["a", "b", "c"] {
//!     assert_eq!(bag.len(), 1);
//!     progress.inc(1);
//! }
//! drop(progress); // clears the status line
//! ```
//!
//! A separate thread reports, so that long single steps are visible too. Everything goes to standard error, since results
//! go to standard output.

mod log;
mod pace;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use log::Log;
use pace::{Pace, SharedPace};
use std::fmt::Write;
use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

const LOG_PERIOD: Duration = Duration::from_secs(10);
/// Period of the status line's updates.
const TICK_PERIOD: Duration = Duration::from_millis(250);

/// The progress of a task; dropped at its end.
pub struct Progress {
    bar: ProgressBar,
    pace: SharedPace,
    /// Set without a terminal.
    _log: Option<Log>,
}

impl Progress {
    /// A task with `total` things: `reading`, `bags`, 12. Things named `bytes` are shown as MiB.
    #[must_use]
    pub fn of(what: &str, things: &'static str, total: u64) -> Self {
        Self::to_stderr(what, things, Some(total))
    }

    /// A task without a known end: shows activity and the number of things.
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
                bar.set_style(make_style(things, total, pace.clone()));
                bar.enable_steady_tick(TICK_PERIOD);
                None
            }
            false => {
                let stderr = Box::new(std::io::stderr());
                Log::start(bar.clone(), pace.clone(), things, LOG_PERIOD, stderr)
            }
        };
        Self {
            bar,
            pace,
            _log: log,
        }
    }

    /// Counts finished things.
    pub fn inc(&self, count: u64) {
        self.pace.get().step(count, Instant::now());
        self.bar.inc(count);
    }

    /// Sets the number of things that were finished earlier and do not count for the pace.
    pub fn resume_at(&self, done: u64) {
        *self.pace.get() = Pace::new(done, Instant::now());
        self.bar.set_position(done);
    }

    /// Sets an additional text until the next call.
    pub fn message(&self, text: impl Into<String>) {
        self.bar.set_message(text.into());
    }

    /// Clears the status line while `print` writes, for example to standard output.
    pub fn suspend<T>(&self, print: impl FnOnce() -> T) -> T {
        self.bar.suspend(print)
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

fn make_style(things: &str, total: Option<u64>, pace: SharedPace) -> ProgressStyle {
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
        // A failed write is repeated at the next tick.
        text.write_str(&pace.describe_rest(state.len())).ok();
    };
    ProgressStyle::with_template(&template)
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .with_key("left", left)
}
