//! Frames one period apart, from a faster camera.

/// Picks the frames that are nearest to one period apart.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    period_ns: i64,
    slack_ns: i64,
    /// When the next frame is due.
    due_ns: Option<i64>,
}

impl Pace {
    /// Frames `period_ns` apart from a camera with `gap_ns` between frames.
    pub fn new(period_ns: i64, gap_ns: i64) -> Self {
        let mut pace = Self {
            period_ns: period_ns.max(1),
            slack_ns: 0,
            due_ns: None,
        };
        pace.set_gap(gap_ns);
        pace
    }

    /// Updates the time between the camera's frames. A frame is due if the next one will be farther from its time, and
    /// up to a quarter period early, since stamps jitter.
    pub fn set_gap(&mut self, gap_ns: i64) {
        self.slack_ns = (gap_ns / 2).clamp(0, self.period_ns / 4);
    }

    /// Whether to pick the frame of this stamp, which must be later than all earlier ones.
    pub fn is_due(&mut self, stamp_ns: i64) -> bool {
        let Some(due_ns) = self.due_ns else {
            self.due_ns = Some(stamp_ns.saturating_add(self.period_ns));
            return true;
        };
        if stamp_ns < due_ns.saturating_sub(self.slack_ns) {
            return false;
        }
        // A late camera restarts the pace; a jittering one keeps it.
        let is_late = stamp_ns.saturating_sub(due_ns) > self.period_ns / 2;
        let from_ns = if is_late { stamp_ns } else { due_ns };
        self.due_ns = Some(from_ns.saturating_add(self.period_ns));
        true
    }

    /// Forgets the picked frames.
    pub fn restart(&mut self) {
        self.due_ns = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: i64 = 200_000_000;

    fn pick(gap_ns: i64, stamps: impl Iterator<Item = i64>) -> Vec<i64> {
        let mut pace = Pace::new(PERIOD, gap_ns);
        stamps.filter(|stamp_ns| pace.is_due(*stamp_ns)).collect()
    }

    #[test]
    fn fast_camera_is_thinned_to_one_frame_per_period() {
        for hertz in [10, 15, 30, 50, 60] {
            let gap = 1_000_000_000 / hertz;
            let count = pick(gap, (0..10 * hertz).map(|tick| tick * gap)).len();
            assert!((49..=51).contains(&count), "{count} at {hertz} Hz");
        }
    }

    #[test]
    fn all_jittering_frames_at_the_model_rate_are_picked() {
        let jitter = [0, 30, -40, 45, -20, 0, -45, 10];
        let stamps = (0..80).map(|tick: i64| tick * PERIOD + jitter[tick as usize % 8] * 1_000_000);
        assert_eq!(pick(PERIOD, stamps).len(), 80);
    }

    #[test]
    fn pace_restarts_after_a_pause() {
        let stamps = [0, 10 * PERIOD + 70_000_000, 11 * PERIOD + 70_000_000];
        assert_eq!(pick(PERIOD, stamps.into_iter()).len(), 3);
    }
}
