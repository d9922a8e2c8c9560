//! Estimate of the remaining time.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use indicatif::HumanDuration;

/// Minimum number of things for an estimate: the first ones warm up.
const STEPS_MIN: u64 = 3;

/// The pace of finished things.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    began: Instant,
    /// Number of things finished earlier.
    before: u64,
    done: u64,
    /// Time of the last one.
    last: Instant,
}

impl Pace {
    pub fn new(done: u64, now: Instant) -> Self {
        Self {
            began: now,
            before: done,
            done,
            last: now,
        }
    }

    /// Counts finished things.
    pub fn step(&mut self, count: u64, now: Instant) {
        self.done += count;
        self.last = now;
    }

    /// Remaining time for `total` things at the mean pace. It decreases during a thing, and increases only when one took longer
    /// than the mean.
    pub fn left(&self, total: u64, now: Instant) -> Option<Duration> {
        let counted = self.done.saturating_sub(self.before);
        let rest = total.saturating_sub(self.done);
        if counted < STEPS_MIN || rest == 0 {
            return None;
        }
        let each = self.last.duration_since(self.began).as_secs_f64() / counted as f64;
        let all = Duration::try_from_secs_f64(each * rest as f64).ok()?;
        Some(all.saturating_sub(now.duration_since(self.last)))
    }
}

/// The pace, shared by workers and reporters.
#[derive(Clone)]
pub(crate) struct SharedPace(Arc<Mutex<Pace>>);

impl Default for SharedPace {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(Pace::new(0, Instant::now()))))
    }
}

impl SharedPace {
    /// Ignores poisoning: no invariant spans the lock.
    pub fn get(&self) -> MutexGuard<'_, Pace> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// `, 40s left`, or empty if unknown.
    pub fn describe_rest(&self, total: Option<u64>) -> String {
        let left = total.and_then(|total| self.get().left(total, Instant::now()));
        left.map_or_else(String::new, |left| {
            format!(", {:#} left", HumanDuration(left))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remaining_time_follows_the_mean_pace() {
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        // Ten things were finished earlier.
        let mut pace = Pace::new(10, start);
        assert_eq!(pace.left(18, at(1)), None);
        for number in 1..=4 {
            pace.step(1, at(number * 30));
        }
        let left = |now| pace.left(18, at(now)).unwrap().as_secs();
        assert_eq!([left(120), left(140), left(10_000)], [120, 100, 0]);
        pace.step(4, at(200));
        assert_eq!(pace.left(18, at(200)), None);
    }
}
