//! How long the rest takes.

use std::time::{Duration, Instant};

/// Things that have to be done before an estimate means anything: the first ones warm up.
const FEWEST: u64 = 3;

/// How fast things are done, as far as it is known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    began: Instant,
    /// Things that were done before that.
    before: u64,
    done: u64,
    /// When the last one was.
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

    /// So many more things are done.
    pub fn step(&mut self, count: u64, now: Instant) {
        self.done += count;
        self.last = now;
    }

    /// Until all of `total` are done, at the mean pace so far: it becomes less while a thing is done, and more only when that
    /// took longer than those before it.
    pub fn left(&self, total: u64, now: Instant) -> Option<Duration> {
        let counted = self.done.saturating_sub(self.before);
        let rest = total.saturating_sub(self.done);
        if counted < FEWEST || rest == 0 {
            return None;
        }
        let each = self.last.duration_since(self.began).as_secs_f64() / counted as f64;
        let all = Duration::try_from_secs_f64(each * rest as f64).ok()?;
        Some(all.saturating_sub(now.duration_since(self.last)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rest_takes_as_long_as_what_was_done_and_not_longer_while_one_is_under_way() {
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        // Ten were done before, which took no time now.
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
