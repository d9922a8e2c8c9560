use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Steps after which time and memory are told: the first ones warm caches and allocator up.
const MEASURED_STEPS: u64 = 4;
/// Between two lines where no progress bar is seen.
const QUIET: Duration = Duration::from_secs(30);

/// The progress of a run: a bar on a terminal, else a line now and then.
pub(super) struct Progress {
    bar: ProgressBar,
    steps: u64,
    done: u64,
    /// When it began, and the steps since.
    since: (Instant, u64),
    said: Instant,
    has_estimated: bool,
}

impl Progress {
    pub(super) fn new(steps: u64, done: u64) -> Self {
        let template = "{bar:30} {pos}/{len} {msg} {per_sec}, {eta} left";
        let style =
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::new(steps).with_style(style);
        bar.set_position(done);
        bar.reset_eta();
        Self {
            bar,
            steps,
            done,
            since: (Instant::now(), 0),
            said: Instant::now(),
            has_estimated: false,
        }
    }

    /// A step is done.
    pub(super) fn step(&mut self, line: &str) {
        self.done += 1;
        self.since.1 += 1;
        self.bar.inc(1);
        self.bar.set_message(line.to_owned());
        if !self.has_estimated && self.since.1 == MEASURED_STEPS {
            self.has_estimated = true;
            let per_step = self.since.0.elapsed() / MEASURED_STEPS as u32;
            let rest = self.left();
            let memory = peak_memory().map_or(String::new(), |gib| format!(", {gib:.1} GiB"));
            self.say(&format!(
                "{per_step:.1?} per step{memory}: about {rest} left"
            ));
            // The first steps are slower than the others.
            self.since = (Instant::now(), 0);
            self.said = Instant::now();
        } else if self.bar.is_hidden() && self.said.elapsed() >= QUIET {
            self.said = Instant::now();
            println!(
                "step {} of {}: {line}, {} left",
                self.done,
                self.steps,
                self.left()
            );
        }
    }

    fn left(&self) -> humantime::FormattedDuration {
        let (began, taken) = self.since;
        let per_step = began.elapsed().as_secs_f64() / taken.max(1) as f64;
        let left = per_step * self.steps.saturating_sub(self.done) as f64;
        humantime::format_duration(Duration::from_secs(left.min(1e9) as u64))
    }

    /// A line of its own.
    pub(super) fn say(&self, line: &str) {
        self.bar.suspend(|| println!("{line}"));
    }

    pub(super) fn end(&self) {
        self.bar.finish_and_clear();
    }
}

/// The most memory that this process has had \[GiB\], as Linux counts it.
fn peak_memory() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / f64::from(1 << 20))
}
