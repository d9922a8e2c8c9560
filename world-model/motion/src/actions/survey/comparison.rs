//! Compares a value of the actions with a value of the recorded state.

use super::moments::Moments;

/// Time over which changes are measured \[s\]: changes over less are within the noise of encoders.
const WINDOW_S: f64 = 0.1;
/// Delays of the state that are tried, from one window early \[windows\].
const DELAYS: usize = 5;
/// Fewer pairs are no evidence.
const LEAST_PAIRS: f64 = 30.0;
/// Least correlations that are evidence. Two slow series correlate by chance more than two changes.
const LEVEL: f64 = 0.7;
const CHANGE: f64 = 0.5;
/// Range of slopes of values in the same unit: a lagging robot has a slope below 1.
const SAME_UNIT: std::ops::RangeInclusive<f64> = 0.4..=2.5;

/// Relation of a value of the actions to a value of the recorded state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StateRelation {
    /// The state follows the value: a target.
    Level {
        /// Pearson's r.
        correlation: f64,
    },
    /// The change of the state follows the value: a velocity or a delta.
    Change {
        /// Pearson's r.
        correlation: f64,
        /// Change of the state per second, for a value of 1.
        per_second: f64,
    },
}

impl StateRelation {
    /// Whether a slope is that of values in the same unit.
    #[must_use]
    pub fn is_same_unit(slope: f64) -> bool {
        SAME_UNIT.contains(&slope)
    }
}

/// Sums over the episodes of a data set.
#[derive(Clone, Debug)]
pub struct StateComparison {
    /// \[Hz\]
    rate: f64,
    /// \[frames\]
    window: usize,
    /// Value and state, by delay.
    levels: [Moments; DELAYS],
    /// Mean value in a window and change of the state per second, by delay.
    changes: [Moments; DELAYS],
}

impl StateComparison {
    /// No episodes yet; actions and states at `rate` \[Hz\].
    #[must_use]
    pub fn new(rate: f64) -> Self {
        Self {
            rate,
            // Rates are at most 10 kHz.
            window: ((rate * WINDOW_S).round() as usize).max(1),
            levels: Default::default(),
            changes: Default::default(),
        }
    }

    /// Adds an episode: the value and the state of each frame.
    pub fn add(&mut self, actions: &[f32], states: &[f64]) {
        let window = self.window;
        let frames = actions.len().min(states.len());
        let Some(last) = frames.checked_sub(window) else {
            return;
        };
        let mut sum: f64 = actions.iter().take(window).copied().map(f64::from).sum();
        let pairs = actions
            .iter()
            .zip(actions.iter().skip(window).map(Some).chain([None]));
        for (frame, (action, next)) in pairs.enumerate().take(last + 1) {
            let mean = sum / window as f64;
            let sums = self.levels.iter_mut().zip(&mut self.changes).enumerate();
            for (delay, (level, change)) in sums {
                let Some(at) = (frame + delay * window).checked_sub(window) else {
                    continue;
                };
                let Some(state) = states.get(at) else {
                    continue;
                };
                level.add(f64::from(*action), *state);
                if let Some(later) = states.get(at + window) {
                    change.add(mean, (later - state) * self.rate / window as f64);
                }
            }
            sum += next.map_or(0.0, |next| f64::from(*next)) - f64::from(*action);
        }
    }

    /// The relation, if the values are evidence of one.
    #[must_use]
    pub fn relation(&self) -> Option<StateRelation> {
        let best = |sums: &[Moments]| {
            let enough = sums.iter().filter(|sums| sums.count >= LEAST_PAIRS);
            let of = |sums: &Moments| (sums.correlation(), *sums);
            enough.map(of).max_by(|(a, _), (b, _)| a.total_cmp(b))
        };
        let is_level = |(correlation, sums): &(f64, Moments)| {
            *correlation >= LEVEL
                && StateRelation::is_same_unit(sums.slope())
                && sums.distance() <= 1.0
        };
        let level = best(&self.levels).filter(is_level);
        let change = best(&self.changes).filter(|(correlation, _)| *correlation >= CHANGE);
        match (level, change) {
            (Some((level, _)), change) if change.is_none_or(|(change, _)| level >= change) => {
                Some(StateRelation::Level { correlation: level })
            }
            (_, Some((correlation, sums))) => Some(StateRelation::Change {
                correlation,
                per_second: sums.slope(),
            }),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// Pseudo-random numbers from -1 to 1.
    fn noise(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 40) as f64 / f64::from(1 << 23) - 1.0
        }
    }

    /// Velocities that change every half a second \[rad/s\].
    fn velocities(rate: usize, seed: u64) -> Vec<f64> {
        let mut random = noise(seed);
        let mut now = 0.0;
        let next = |frame: usize| {
            if frame.is_multiple_of(rate / 2) {
                now = random();
            }
            now
        };
        (0..20 * rate).map(next).collect()
    }

    /// States that follow velocities, `late` frames late, with noise of an encoder.
    fn states(velocities: &[f64], rate: usize, late: usize) -> Vec<f64> {
        let mut random = noise(9);
        let mut now = 0.7;
        let mut states = vec![now; late];
        for velocity in velocities {
            states.push(now + 5e-4 * random());
            now += velocity / rate as f64;
        }
        states.truncate(velocities.len());
        states
    }

    fn relation(rate: usize, actions: &[f64], states: &[f64]) -> Option<StateRelation> {
        let mut comparison = StateComparison::new(rate as f64);
        let actions: Vec<f32> = actions.iter().map(|value| *value as f32).collect();
        comparison.add(&actions, states);
        comparison.relation()
    }

    #[test]
    fn velocities_and_deltas_are_found_at_any_rate_and_delay() {
        for rate in [5, 10, 15, 30, 50] {
            for late in [0, rate / 5] {
                let velocities = velocities(rate, 3);
                let states = states(&velocities, rate, late);
                for (per, expected) in [(1.0, 1.0), (rate as f64, rate as f64)] {
                    let actions: Vec<f64> = velocities.iter().map(|v| v / per).collect();
                    let found = relation(rate, &actions, &states).unwrap();
                    let StateRelation::Change {
                        correlation,
                        per_second,
                    } = found
                    else {
                        panic!("{rate} Hz: {found:?}")
                    };
                    assert!(correlation > 0.8, "{rate} Hz, {late} late: {found:?}");
                    let ratio = per_second / expected;
                    assert!((0.7..1.3).contains(&ratio), "{rate} Hz: {found:?}");
                }
            }
        }
    }

    #[test]
    fn targets_are_found_although_the_state_is_late() {
        for rate in [5, 15, 50] {
            let targets = states(&velocities(rate, 4), rate, 0);
            let mut late = vec![targets[0]; rate / 5];
            late.extend(&targets);
            late.truncate(targets.len());
            let found = relation(rate, &targets, &late).unwrap();
            let is_target =
                matches!(found, StateRelation::Level { correlation } if correlation > 0.95);
            assert!(is_target, "{rate} Hz: {found:?}");
        }
    }

    #[test]
    fn unrelated_constant_and_few_values_have_no_relation() {
        let (a, b) = (velocities(10, 5), velocities(10, 6));
        assert_eq!(relation(10, &a, &states(&b, 10, 0)), None);
        let constant = vec![1.5; 200];
        assert_eq!(relation(10, &constant, &constant), None);
        assert_eq!(relation(10, &a[..20], &states(&a[..20], 10, 0)), None);
        assert_eq!(relation(10, &[], &[]), None);
    }
}
