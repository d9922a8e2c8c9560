use std::time::{Duration, Instant};

/// Steps until time and memory are printed: the first ones warm up caches and allocator.
const MEASURED_STEPS: u64 = 4;

/// The progress of a run.
pub(super) struct Progress {
    told: wm_program::progress::Progress,
    steps: u64,
    done: u64,
    /// Time and step of the start.
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

    /// Reports a step.
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
            // The first steps are slower.
            self.told.resume_at(self.done);
        }
    }

    /// Shows that the model is validated after the step of `line`.
    pub(super) fn validating(&self, line: &str) {
        self.told.message(format!("{line}, validating"));
    }

    /// Prints a separate line.
    pub(super) fn say(&self, line: &str) {
        self.told.suspend(|| println!("{line}"));
    }
}

/// Peak memory of this process \[GiB\], from Linux.
fn peak_memory() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / f64::from(1 << 20))
}
