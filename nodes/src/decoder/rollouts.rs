//! Which rollouts are decoded.

/// Chooses rollouts whose observations are at least a period apart: at a camera's rate neighbouring rollouts show much
/// the same, and decoding them all is the most expensive thing that the suite does.
#[derive(Debug)]
pub(super) struct Rollouts {
    period_ns: i64,
    chosen_ns: Option<i64>,
}

/// How much earlier than a period after the last an observation may be \[ns\].
const JITTER_NS: i64 = 50_000_000;

impl Rollouts {
    pub(super) fn every(period_ns: i64) -> Self {
        Self {
            period_ns,
            chosen_ns: None,
        }
    }

    /// Whether a prediction from this observation is decoded.
    pub(super) fn choose(&mut self, observed_ns: i64) -> bool {
        let is_due = self.chosen_ns.is_none_or(|chosen_ns| {
            let since_ns = observed_ns.saturating_sub(chosen_ns);
            // before it: time has jumped
            since_ns < 0 || since_ns > self.period_ns - JITTER_NS.min(self.period_ns / 4)
        });
        if is_due {
            self.chosen_ns = Some(observed_ns);
        }
        is_due || self.chosen_ns == Some(observed_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: i64 = 200_000_000;

    #[test]
    fn every_step_of_every_second_observation_is_decoded() {
        let mut rollouts = Rollouts::every(2 * FRAME);
        let jitter = [0, -9_000_000, 9_000_000, -9_000_000, 0, 9_000_000];
        let chosen: Vec<bool> = (0..6)
            .zip(jitter)
            .flat_map(|(frame, jitter)| {
                let observed_ns = frame * FRAME + jitter;
                [rollouts.choose(observed_ns), rollouts.choose(observed_ns)]
            })
            .collect();
        let expected = [true, true, false, false];
        assert_eq!(chosen, expected.repeat(3));
        assert!(rollouts.choose(-10 * FRAME), "time jumped back");
    }

    #[test]
    fn without_a_period_all_are_decoded() {
        let mut rollouts = Rollouts::every(0);
        assert!((0..5).all(|frame| rollouts.choose(frame * FRAME)));
    }
}
