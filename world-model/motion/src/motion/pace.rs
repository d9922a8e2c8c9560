//! Frames that are a period apart, of a camera that may be faster.

/// Picks the frames that are nearest to a period apart.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    period_ns: i64,
    slack_ns: i64,
    /// When the next one is due.
    due_ns: Option<i64>,
}

impl Pace {
    /// Frames `period_ns` apart, of a camera with `gap_ns` between frames. Nothing is picked yet.
    pub fn new(period_ns: i64, gap_ns: i64) -> Self {
        let mut pace = Self {
            period_ns: period_ns.max(1),
            slack_ns: 0,
            due_ns: None,
        };
        pace.set_gap(gap_ns);
        pace
    }

    /// Takes note of how far apart the camera's frames are: one that is nearer to its time than the next will be is due,
    /// and so is one that comes a quarter of a period early, since stamps jitter.
    pub fn set_gap(&mut self, gap_ns: i64) {
        self.slack_ns = (gap_ns / 2).clamp(0, self.period_ns / 4);
    }

    /// Whether the frame of this stamp, which is later than all before, is picked.
    pub fn is_due(&mut self, stamp_ns: i64) -> bool {
        let Some(due_ns) = self.due_ns else {
            self.due_ns = Some(stamp_ns.saturating_add(self.period_ns));
            return true;
        };
        if stamp_ns < due_ns.saturating_sub(self.slack_ns) {
            return false;
        }
        // A camera that is late sets the pace anew; one that jitters keeps it.
        let is_late = stamp_ns.saturating_sub(due_ns) > self.period_ns / 2;
        let from_ns = if is_late { stamp_ns } else { due_ns };
        self.due_ns = Some(from_ns.saturating_add(self.period_ns));
        true
    }

    /// Forgets what was picked.
    pub fn restart(&mut self) {
        self.due_ns = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: i64 = 200_000_000;

    fn picked(gap_ns: i64, stamps: impl Iterator<Item = i64>) -> Vec<i64> {
        let mut pace = Pace::new(PERIOD, gap_ns);
        stamps.filter(|stamp_ns| pace.is_due(*stamp_ns)).collect()
    }

    #[test]
    fn of_a_fast_camera_one_a_period_is_picked() {
        for hertz in [10, 15, 30, 50, 60] {
            let gap = 1_000_000_000 / hertz;
            let count = picked(gap, (0..10 * hertz).map(|tick| tick * gap)).len();
            assert!((49..=51).contains(&count), "{count} at {hertz} Hz");
        }
    }

    #[test]
    fn of_a_camera_at_the_rate_all_are_picked_though_stamps_jitter() {
        let jitter = [0, 30, -40, 45, -20, 0, -45, 10];
        let stamps = (0..80).map(|tick: i64| tick * PERIOD + jitter[tick as usize % 8] * 1_000_000);
        assert_eq!(picked(PERIOD, stamps).len(), 80);
    }

    #[test]
    fn after_a_pause_the_pace_begins_anew() {
        let stamps = [0, 10 * PERIOD + 70_000_000, 11 * PERIOD + 70_000_000];
        assert_eq!(picked(PERIOD, stamps.into_iter()).len(), 3);
    }
}
