//! The distribution that candidates are drawn from.

use crate::{Range, SearchSpace, search::Scored};

/// Probability that a value which is one of two is never decided beyond, so that a search can still change its mind.
const UNDECIDED: f32 = 0.02;

/// A Gaussian for each value of a plan, all independent; for values that are one of two, the probability of the second.
#[derive(Clone, Debug)]
pub(crate) struct Proposal {
    /// Steps x searched values.
    mean: Vec<f32>,
    std: Vec<f32>,
    /// Of the searched values of a step.
    ranges: Vec<Range>,
    floor: f32,
}

impl Proposal {
    /// A distribution about `plan` (steps x searched values), with `initial_std` as a part of each value's range, and
    /// never less than `floor` \[model units\].
    pub(crate) fn about(space: &SearchSpace, plan: &[f32], initial_std: f32, floor: f32) -> Self {
        let ranges: Vec<Range> = space.coordinates().iter().map(|c| c.range).collect();
        let (mut mean, mut std) = (Vec::new(), Vec::new());
        for (value, range) in plan.iter().zip(ranges.iter().cycle()) {
            let (low, high) = range.bounds();
            match range {
                Range::Between(..) => {
                    mean.push(*value);
                    std.push(((high - low) * initial_std).max(floor));
                }
                // A plan that is known keeps a preference; without one both are as likely.
                Range::Either(..) => {
                    let is_second = f32::from(u8::from(*value > (low + high) / 2.0));
                    mean.push(is_second * 0.5 + 0.25);
                    std.push(0.0);
                }
            }
        }
        Self {
            mean,
            std,
            ranges,
            floor,
        }
    }

    /// The candidate of standard normal `noise`, one number a value.
    pub(crate) fn draw(&self, mut noise: impl FnMut() -> f32) -> Vec<f32> {
        let parameters = self
            .mean
            .iter()
            .zip(&self.std)
            .zip(self.ranges.iter().cycle());
        let values = parameters.map(|((mean, std), range)| {
            let noise = noise();
            match *range {
                Range::Between(..) => mean + std * noise,
                Range::Either(low, high) => {
                    if normal_below(noise) < *mean {
                        high
                    } else {
                        low
                    }
                }
            }
        });
        values.collect()
    }

    /// The middle of the distribution, as a plan.
    pub(crate) fn middle(&self) -> Vec<f32> {
        let means = self.mean.iter().zip(self.ranges.iter().cycle());
        let values = means.map(|(mean, range)| match *range {
            Range::Between(..) => *mean,
            Range::Either(low, high) => {
                if *mean > 0.5 {
                    high
                } else {
                    low
                }
            }
        });
        values.collect()
    }

    /// Moves to the mean and the unbiased standard deviation of at least two elites, keeping `momentum` of what it was;
    /// sums in f64. Fewer say nothing about the spread, and change nothing.
    pub(crate) fn fit(&mut self, elites: &[Scored], momentum: f32) {
        if elites.len() < 2 {
            return;
        }
        let weights = vec![1.0 / elites.len() as f64; elites.len()];
        // Counts stay far below 2^52.
        let count = elites.len() as f64;
        self.move_to(elites, &weights, momentum, count / (count - 1.0));
    }

    /// Moves to the mean and standard deviation of candidates by `weights` that sum to 1.
    pub(crate) fn fit_weighted(&mut self, candidates: &[Scored], weights: &[f64], momentum: f32) {
        self.move_to(candidates, weights, momentum, 1.0);
    }

    fn move_to(&mut self, candidates: &[Scored], weights: &[f64], momentum: f32, correction: f64) {
        let ranges = self.ranges.iter().cycle();
        let parameters = self.mean.iter_mut().zip(&mut self.std).zip(ranges);
        for (index, ((mean, std), range)) in parameters.enumerate() {
            let values = || {
                candidates
                    .iter()
                    .zip(weights)
                    .filter_map(|(candidate, weight)| {
                        let value = candidate.actions.get(index)?;
                        Some((f64::from(*value), *weight))
                    })
            };
            let keep = |old: f32, new: f32| momentum * old + (1.0 - momentum) * new;
            match *range {
                Range::Between(..) => {
                    let centre: f64 = values().map(|(value, weight)| value * weight).sum();
                    let variance: f64 = values()
                        .map(|(value, weight)| (value - centre).powi(2) * weight)
                        .sum();
                    let spread = (variance * correction).sqrt() as f32;
                    *mean = keep(*mean, centre as f32);
                    *std = keep(*std, spread).max(self.floor);
                }
                Range::Either(low, high) => {
                    let middle = f64::from(low + high) / 2.0;
                    let second: f64 = values()
                        .filter(|(value, _)| *value > middle)
                        .map(|(_, weight)| weight)
                        .sum();
                    *mean = keep(*mean, second as f32).clamp(UNDECIDED, 1.0 - UNDECIDED);
                }
            }
        }
    }
}

/// Probability that a standard normal number is below `value`; the logistic approximation, off by at most .01.
fn normal_below(value: f32) -> f32 {
    1.0 / (1.0 + (-1.702 * value).exp())
}
