//! Which rollouts are decoded.

use std::time::{Duration, Instant};

use crate::cadence::{Cadence, Load, Verdict};

/// Chooses rollouts whose observations are at least a period apart: at a camera's rate neighbouring rollouts show much
/// the same, and decoding them all is the most expensive thing that the suite does.
#[derive(Debug)]
pub(super) struct Rollouts {
    period_ns: i64,
    /// Every how many of these are decoded, where their pictures take longer than a period.
    cadence: Cadence,
    /// The newest observation, and what becomes of its rollout.
    newest: Option<(i64, Choice)>,
    /// The last observation whose rollout was decoded, or would have been but for the pace.
    decoded_ns: Option<i64>,
}

/// Rollouts of all frames are decoded: that they come as fast as the usual camera's frames is a first guess.
const SHORTEST: Duration = Duration::from_millis(200);
/// How much earlier than a period after the last an observation may be \[ns\].
const JITTER_NS: i64 = 50_000_000;

/// What becomes of a prediction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Choice {
    /// Its picture is made.
    Decode,
    /// Its rollout is not due, as the parameter says.
    Skip,
    /// Its rollout is left out by choice: decoding all that are due takes too long.
    Pace,
    /// Its rollout was due when the pictures of the one before were not made yet.
    Overload,
}

impl Rollouts {
    /// Rollouts at least `period_ns` apart. The pictures of one took `estimate` in the trial.
    pub(super) fn every(period_ns: i64, estimate: Option<Duration>) -> Self {
        let period = Duration::from_nanos(period_ns.unsigned_abs()).max(SHORTEST);
        Self {
            period_ns,
            cadence: Cadence::new(period, estimate),
            newest: None,
            decoded_ns: None,
        }
    }

    /// The pictures of a rollout took this long together.
    pub(super) fn took(&mut self, taken: Duration) {
        self.cadence.took(taken);
    }

    /// Every how many of the rollouts that are due one is decoded.
    pub(super) fn cadence(&mut self) -> &mut Cadence {
        &mut self.cadence
    }

    /// What becomes of a prediction from this observation that comes at `now`. `is_behind` tells whether pictures wait to
    /// be made: then no new rollout is begun, since half a rollout, late, is worth less than none.
    pub(super) fn choose(&mut self, observed_ns: i64, is_behind: bool, now: Instant) -> Choice {
        match self.newest {
            Some((newest_ns, choice)) if newest_ns == observed_ns => return choice,
            _ => {}
        }
        let is_due = self.decoded_ns.is_none_or(|decoded_ns| {
            let since_ns = observed_ns.saturating_sub(decoded_ns);
            // before it: time has jumped
            since_ns < 0 || since_ns > self.period_ns - JITTER_NS.min(self.period_ns / 4)
        });
        let choice = match is_due {
            false => Choice::Skip,
            true => self.choose_due(observed_ns, is_behind, now),
        };
        self.newest = Some((observed_ns, choice));
        choice
    }

    fn choose_due(&mut self, observed_ns: i64, is_behind: bool, now: Instant) -> Choice {
        let load = if is_behind { Load::Busy } else { Load::Idle };
        match (self.cadence.arrived(observed_ns, now, load), is_behind) {
            (Verdict::Use, true) => return Choice::Overload,
            (Verdict::Use, false) => {}
            _ => {
                // It was its turn: the next is due a period later.
                self.decoded_ns = Some(observed_ns);
                return Choice::Pace;
            }
        }
        self.decoded_ns = Some(observed_ns);
        Choice::Decode
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: i64 = 200_000_000;

    fn choose(rollouts: &mut Rollouts, observed_ns: i64, is_behind: bool) -> Choice {
        rollouts.choose(observed_ns, is_behind, Instant::now())
    }

    #[test]
    fn every_step_of_every_second_observation_is_decoded() {
        use Choice::{Decode, Skip};
        let mut rollouts = Rollouts::every(2 * FRAME, None);
        let jitter = [0, -9_000_000, 9_000_000, -9_000_000, 0, 9_000_000];
        let chosen: Vec<Choice> = (0..6)
            .zip(jitter)
            .flat_map(|(frame, jitter)| {
                let observed_ns = frame * FRAME + jitter;
                // while its first picture is made the rest of the rollout waits
                [
                    choose(&mut rollouts, observed_ns, false),
                    choose(&mut rollouts, observed_ns, true),
                ]
            })
            .collect();
        assert_eq!(chosen, [Decode, Decode, Skip, Skip].repeat(3));
        assert_eq!(
            choose(&mut rollouts, -10 * FRAME, false),
            Decode,
            "time jumped"
        );
    }

    #[test]
    fn without_a_period_all_are_decoded() {
        let mut rollouts = Rollouts::every(0, None);
        assert!((0..5).all(|frame| choose(&mut rollouts, frame * FRAME, false) == Choice::Decode));
    }

    #[test]
    fn a_rollout_that_comes_too_early_is_left_out_whole() {
        use Choice::{Decode, Overload};
        let mut rollouts = Rollouts::every(2 * FRAME, None);
        assert_eq!(choose(&mut rollouts, 0, false), Decode);
        // the queue has room again by its second step, but its first is gone
        assert_eq!(choose(&mut rollouts, 2 * FRAME, true), Overload);
        assert_eq!(choose(&mut rollouts, 2 * FRAME, false), Overload);
        assert_eq!(choose(&mut rollouts, 3 * FRAME, false), Decode);
    }

    #[test]
    fn slow_decoder_skips_whole_rollouts() {
        use Choice::{Decode, Pace};
        let period = Duration::from_millis(400);
        let mut rollouts = Rollouts::every(2 * FRAME, Some(period * 5 / 2));
        let begin = Instant::now();
        let chosen: Vec<Choice> = (0..9_u32)
            .flat_map(|rollout| {
                let observed_ns = i64::from(rollout) * 2 * FRAME;
                let now = begin + period * rollout;
                [(); 2].map(|()| rollouts.choose(observed_ns, false, now))
            })
            .collect();
        let expected = [Decode, Decode, Pace, Pace, Pace, Pace];
        assert_eq!(chosen, expected.repeat(3));
    }
}
