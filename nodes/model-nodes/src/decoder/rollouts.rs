//! Which rollouts are decoded.

/// Chooses rollouts whose observations are at least a period apart: at a camera's rate neighbouring rollouts show much
/// the same, and decoding them all is the most expensive thing that the suite does.
#[derive(Debug)]
pub(super) struct Rollouts {
    period_ns: i64,
    /// The newest observation, and what becomes of its rollout.
    newest: Option<(i64, Choice)>,
    /// The last observation whose rollout was decoded.
    decoded_ns: Option<i64>,
}

/// How much earlier than a period after the last an observation may be \[ns\].
const JITTER_NS: i64 = 50_000_000;

/// What becomes of a prediction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Choice {
    /// Its picture is made.
    Decode,
    /// Its rollout is not due.
    Skip,
    /// Its rollout was due when the pictures of the one before were not made yet.
    Overload,
}

impl Rollouts {
    pub(super) fn every(period_ns: i64) -> Self {
        Self {
            period_ns,
            newest: None,
            decoded_ns: None,
        }
    }

    /// What becomes of a prediction from this observation. `is_behind` tells whether pictures wait to be made: then no
    /// new rollout is begun, since half a rollout, late, is worth less than none.
    pub(super) fn choose(&mut self, observed_ns: i64, is_behind: bool) -> Choice {
        match self.newest {
            Some((newest_ns, choice)) if newest_ns == observed_ns => return choice,
            _ => {}
        }
        let is_due = self.decoded_ns.is_none_or(|decoded_ns| {
            let since_ns = observed_ns.saturating_sub(decoded_ns);
            // before it: time has jumped
            since_ns < 0 || since_ns > self.period_ns - JITTER_NS.min(self.period_ns / 4)
        });
        let choice = match (is_due, is_behind) {
            (false, _) => Choice::Skip,
            (true, true) => Choice::Overload,
            (true, false) => Choice::Decode,
        };
        if choice == Choice::Decode {
            self.decoded_ns = Some(observed_ns);
        }
        self.newest = Some((observed_ns, choice));
        choice
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: i64 = 200_000_000;

    #[test]
    fn every_step_of_every_second_observation_is_decoded() {
        use Choice::{Decode, Skip};
        let mut rollouts = Rollouts::every(2 * FRAME);
        let jitter = [0, -9_000_000, 9_000_000, -9_000_000, 0, 9_000_000];
        let chosen: Vec<Choice> = (0..6)
            .zip(jitter)
            .flat_map(|(frame, jitter)| {
                let observed_ns = frame * FRAME + jitter;
                // while its first picture is made the rest of the rollout waits
                [
                    rollouts.choose(observed_ns, false),
                    rollouts.choose(observed_ns, true),
                ]
            })
            .collect();
        assert_eq!(chosen, [Decode, Decode, Skip, Skip].repeat(3));
        assert_eq!(rollouts.choose(-10 * FRAME, false), Decode, "time jumped");
    }

    #[test]
    fn without_a_period_all_are_decoded() {
        let mut rollouts = Rollouts::every(0);
        assert!((0..5).all(|frame| rollouts.choose(frame * FRAME, false) == Choice::Decode));
    }

    #[test]
    fn a_rollout_that_comes_too_early_is_left_out_whole() {
        use Choice::{Decode, Overload};
        let mut rollouts = Rollouts::every(2 * FRAME);
        assert_eq!(rollouts.choose(0, false), Decode);
        // the queue has room again by its second step, but its first is gone
        assert_eq!(rollouts.choose(2 * FRAME, true), Overload);
        assert_eq!(rollouts.choose(2 * FRAME, false), Overload);
        assert_eq!(rollouts.choose(3 * FRAME, false), Decode);
    }
}
