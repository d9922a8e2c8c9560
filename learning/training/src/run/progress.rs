use std::time::{Duration, Instant};

/// Steps after which time and memory are told: the first ones warm caches and allocator up.
const MEASURED_STEPS: u64 = 4;

/// The progress of a run.
pub(super) struct Progress {
    told: wm_program::progress::Progress,
    steps: u64,
    done: u64,
    /// When it began, and the steps since.
    since: (Instant, u64),
}

impl Progress {
    pub(super) fn new(steps: u64, done: u64) -> Self {
        let told = wm_program::progress::Progress::of("training", "steps", steps);
        told.resume_at(done);
        Self {
            told,
            steps,
            done,
            since: (Instant::now(), 0),
        }
    }

    /// A step is done.
    pub(super) fn step(&mut self, line: &str) {
        self.done += 1;
        self.since.1 += 1;
        self.told.inc(1);
        self.told.message(line);
        if self.since.1 == MEASURED_STEPS {
            let per_step = self.since.0.elapsed() / MEASURED_STEPS as u32;
            let left = per_step.as_secs_f64() * self.steps.saturating_sub(self.done) as f64;
            let left = humantime::format_duration(Duration::from_secs(left.min(1e9) as u64));
            let memory = peak_memory().map_or(String::new(), |gib| format!(", {gib:.1} GiB"));
            self.say(&format!(
                "{per_step:.1?} per step{memory}: about {left} left"
            ));
            // The first steps are slower than the others.
            self.told.resume_at(self.done);
        }
    }

    /// A line of its own.
    pub(super) fn say(&self, line: &str) {
        self.told.suspend(|| println!("{line}"));
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
