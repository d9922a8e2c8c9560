//! The distribution of candidates.

use crate::{Range, SearchSpace, search::ScoredCandidate};

/// Bounds the probability of a two-valued coordinate, so that the search can still change its value.
const UNDECIDED: f32 = 0.02;

/// An independent Gaussian for each value of a plan; for a two-valued coordinate, the probability of its second value.
#[derive(Clone, Debug)]
pub(crate) struct Proposal {
    /// Steps x searched values.
    mean: Vec<f32>,
    std: Vec<f32>,
    /// Ranges of the searched values of one step.
    ranges: Vec<Range>,
    floor: f32,
}

impl Proposal {
    /// A distribution around `plan` (steps x searched values), with `initial_std` as a share of each value's range, at
    /// least `floor` \[model units\].
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
                // A known plan is preferred; without one, both values are equally likely.
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

    /// The candidate for standard normal `noise`, one number per value.
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

    /// The mean as a plan.
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

    /// Fits mean and unbiased standard deviation to at least two elites, keeping a `momentum` share of the old
    /// distribution. Fewer elites have no spread and change nothing. Sums in f64.
    pub(crate) fn fit(&mut self, elites: &[ScoredCandidate], momentum: f32) {
        if elites.len() < 2 {
            return;
        }
        let weights = vec![1.0 / elites.len() as f64; elites.len()];
        // Counts stay far below 2^52.
        let count = elites.len() as f64;
        self.move_to(elites, &weights, momentum, count / (count - 1.0));
    }

    /// Fits mean and standard deviation to candidates with `weights` of sum 1.
    pub(crate) fn fit_weighted(
        &mut self,
        candidates: &[ScoredCandidate],
        weights: &[f64],
        momentum: f32,
    ) {
        self.move_to(candidates, weights, momentum, 1.0);
    }

    fn move_to(
        &mut self,
        candidates: &[ScoredCandidate],
        weights: &[f64],
        momentum: f32,
        correction: f64,
    ) {
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

/// Probability that a standard normal number is below `value`, by the logistic approximation (error at most 0.01).
fn normal_below(value: f32) -> f32 {
    1.0 / (1.0 + (-1.702 * value).exp())
}
