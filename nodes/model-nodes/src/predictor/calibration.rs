//! How far predicted motion is scaled, so that it fits the motion that was seen.
//!
//! A prediction of step k moves from the observed latent `z` to `z + p`; the frame of the predicted time then shows
//! `z + m`. Of all factors, `a = Σ p·m / Σ p·p` makes the squared error of `z + a p` least. A model that does not know
//! the scene has a factor near 0, and its calibrated prediction is the last frame. The factor is fitted for each k to the
//! last scored predictions, with a prior of 1, and applies to what is published; a rollout itself goes on from the
//! unscaled latents.

use std::collections::BTreeMap;

/// Scored predictions that are kept beyond the window, because frames may arrive while a rollout is computed.
const SPARE: usize = 64;

/// Settings of the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationSettings {
    /// Scored predictions of each k that count.
    pub window: usize,
    /// Weight of the prior, a factor of 1, in scored predictions.
    pub prior: f64,
    /// The least and the greatest factor.
    pub bounds: (f64, f64),
}

/// A prediction beside what was seen: sums over the values of a latent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Comparison {
    /// Product of predicted and seen motion.
    product: f64,
    /// Square of the predicted motion.
    predicted: f64,
    /// Square of the seen motion.
    seen: f64,
    /// Number of values.
    count: usize,
}

impl Comparison {
    /// Of three latents of one space: the observed one, the prediction from it, and the one that was seen at the
    /// predicted time.
    pub(super) fn new(observed: &[f32], predicted: &[f32], seen: &[f32]) -> Self {
        let mut sums = Self {
            count: observed.len().max(1),
            ..Self::default()
        };
        for ((observed, predicted), seen) in observed.iter().zip(predicted).zip(seen) {
            let observed = f64::from(*observed);
            let (p, m) = (
                f64::from(*predicted) - observed,
                f64::from(*seen) - observed,
            );
            sums.product += p * m;
            sums.predicted += p * p;
            sums.seen += m * m;
        }
        sums
    }

    /// Sum of the squared errors of the prediction whose motion is scaled by `factor`.
    fn squares(&self, factor: f64) -> f64 {
        let sum = self.seen - 2.0 * factor * self.product + factor * factor * self.predicted;
        // Rounding may leave a perfect prediction just below 0.
        if sum < 0.0 { 0.0 } else { sum }
    }

    /// Mean squared error of the prediction whose motion is scaled by `factor`.
    pub(super) fn error(&self, factor: f64) -> f64 {
        self.squares(factor) / self.count as f64
    }

    /// Mean squared error of the persistence baseline.
    pub(super) fn persistence(&self) -> f64 {
        self.seen / self.count as f64
    }

    fn is_finite(&self) -> bool {
        [self.product, self.predicted, self.seen]
            .iter()
            .all(|sum| sum.is_finite())
    }
}

/// A factor, and how well it fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// By what the predicted motion is multiplied.
    pub factor: f64,
    /// Part of the squared motion that the predictions of the window, scaled by the factor, explain: 1 for perfect ones, 0
    /// for the persistence baseline. `None` if none is scored or nothing moved.
    pub explained: Option<f64>,
}

/// The scored predictions of each k.
#[derive(Clone, Debug)]
pub(super) struct Calibration {
    settings: CalibrationSettings,
    /// By k, and by the stamp of the frame that was seen \[ns\].
    scored: BTreeMap<u32, BTreeMap<i64, Comparison>>,
}

impl Calibration {
    pub(super) fn new(settings: CalibrationSettings) -> Self {
        Self {
            settings,
            scored: BTreeMap::new(),
        }
    }

    /// Records a prediction of step `k` that was compared with the frame of `seen_ns`. One with NaN or an infinite value does
    /// not count.
    pub(super) fn add(&mut self, k: u32, seen_ns: i64, comparison: Comparison) {
        if !comparison.is_finite() {
            return;
        }
        let scored = self.scored.entry(k).or_default();
        scored.insert(seen_ns, comparison);
        while scored.len() > self.settings.window.saturating_add(SPARE) {
            scored.pop_first();
        }
    }

    /// The fit for step `k` of a rollout from the observation of `observed_ns`. Only frames up to then count, so the
    /// fit does not depend on those that arrive while the rollout is computed.
    pub(super) fn fit(&self, k: u32, observed_ns: i64) -> Fit {
        let CalibrationSettings {
            window,
            prior,
            bounds: (least, greatest),
        } = self.settings;
        let (mut sums, mut number) = (Comparison::default(), 0.0);
        let scored = self.scored.get(&k);
        let until = scored.map(|scored| scored.range(..=observed_ns));
        for (_, one) in until.into_iter().flatten().rev().take(window) {
            sums.product += one.product;
            sums.predicted += one.predicted;
            sums.seen += one.seen;
            number += 1.0;
        }
        // The prior is that many predictions that moved as far as the scene does, and were right.
        let right = match number > 0.0 {
            true => prior * sums.seen / number,
            false => 0.0,
        };
        let predicted = sums.predicted + right;
        let factor = match predicted > 0.0 {
            true => (sums.product + right) / predicted,
            false => 1.0,
        };
        let factor = factor.max(least).min(greatest);
        let explained = 1.0 - sums.squares(factor) / sums.seen;
        Fit {
            factor,
            explained: explained.is_finite().then_some(explained),
        }
    }

    /// Forgets all predictions, because another history begins.
    pub(super) fn clear(&mut self) {
        self.scored.clear();
    }
}

/// The latent whose motion away from `observed` is `factor` times the predicted one.
pub(super) fn scaled(observed: &[f32], predicted: &[f32], factor: f64) -> Vec<f32> {
    let between = |(observed, predicted): (&f32, &f32)| {
        let start = f64::from(*observed);
        (start + factor * (f64::from(*predicted) - start)) as f32
    };
    observed.iter().zip(predicted).map(between).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use rand::{Rng as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    const SETTINGS: CalibrationSettings = CalibrationSettings {
        window: 50,
        prior: 1.0,
        bounds: (0.0, 1.0),
    };

    /// A comparison of `count` values whose predicted motion is `scale` times the seen one, plus noise of that width.
    fn comparison(random: &mut ChaCha8Rng, scale: f32, noise: f32) -> Comparison {
        let mut value = |width: f32| width * random.random_range(-1.0..1.0_f32);
        let observed: Vec<f32> = (0..64).map(|_| value(1.0)).collect();
        let motion: Vec<f32> = (0..64).map(|_| value(1.0)).collect();
        let seen: Vec<f32> = observed.iter().zip(&motion).map(|(z, m)| z + m).collect();
        let predicted = observed.iter().zip(&motion);
        let predicted: Vec<f32> = predicted
            .map(|(z, m)| z + scale * m + value(noise))
            .collect();
        Comparison::new(&observed, &predicted, &seen)
    }

    fn calibration(scale: f32, noise: f32, prior: f64) -> (Calibration, Vec<Comparison>) {
        let mut calibration = Calibration::new(CalibrationSettings { prior, ..SETTINGS });
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let scored: Vec<_> = (0..40)
            .map(|_| comparison(&mut random, scale, noise))
            .collect();
        for (index, one) in (0..).zip(&scored) {
            calibration.add(1, index, *one);
        }
        (calibration, scored)
    }

    #[test]
    fn no_other_factor_has_a_smaller_error() {
        for (scale, noise) in [(1.3, 0.4), (0.7, 2.0), (2.0, 0.0)] {
            let (calibration, scored) = calibration(scale, noise, 0.0);
            let fit = calibration.fit(1, 100);
            let error = |factor: f64| scored.iter().map(|one| one.error(factor)).sum::<f64>();
            for step in 0..=100 {
                let other = f64::from(step) / 100.0;
                assert!(error(fit.factor) <= error(other) + 1e-9, "{other}: {fit:?}");
            }
            let still: f64 = scored.iter().map(Comparison::persistence).sum();
            let explained = 1.0 - error(fit.factor) / still;
            assert!((fit.explained.unwrap() - explained).abs() < 1e-9);
        }
    }

    #[test]
    fn error_of_a_factor_is_that_of_the_scaled_latent() {
        let (observed, predicted, seen) = ([0.5, -1.0, 2.0], [1.0, 1.0, 2.5], [0.0, 3.0, 2.0]);
        let comparison = Comparison::new(&observed, &predicted, &seen);
        for factor in [0.0, 0.3, 1.0, 1.7] {
            let scaled = scaled(&observed, &predicted, factor);
            let error = wm_metrics::images::mean_squared_error(&scaled, &seen).unwrap();
            assert!((comparison.error(factor) - error).abs() < 1e-6, "{factor}");
        }
        assert_eq!(scaled(&observed, &predicted, 0.0), observed);
    }

    #[test]
    fn factor_is_one_until_a_prediction_is_scored_and_for_perfect_ones() {
        let calibration_of_nothing = Calibration::new(SETTINGS);
        let fit = calibration_of_nothing.fit(1, 100);
        assert_eq!((fit.factor, fit.explained), (1.0, None));
        let (perfect, _) = calibration(1.0, 0.0, 1.0);
        let fit = perfect.fit(1, 100);
        assert!((fit.factor - 1.0).abs() < 1e-6 && fit.explained.unwrap() > 0.999_999);
        assert_eq!(
            perfect.fit(2, 100).factor,
            1.0,
            "no prediction of k = 2 is scored"
        );
    }

    /// Predictions that have nothing to do with what is seen.
    #[test]
    fn calibrated_noise_is_hardly_worse_than_the_persistence_baseline() {
        for (seed, noise) in [(1, 0.3), (2, 1.0), (3, 5.0), (4, 100.0)] {
            let (mut calibration, mut random) =
                (Calibration::new(SETTINGS), ChaCha8Rng::seed_from_u64(seed));
            let (mut error, mut still) = (0.0, 0.0);
            for index in 0..400 {
                let one = comparison(&mut random, 0.0, noise);
                if index >= 20 {
                    error += one.error(calibration.fit(1, index).factor);
                    still += one.persistence();
                }
                calibration.add(1, index, one);
            }
            assert!(error <= 1.02 * still, "{noise}: {}", error / still);
        }
    }

    #[test]
    fn factor_keeps_its_bounds() {
        let (backwards, _) = calibration(-1.0, 0.0, 0.0);
        assert_eq!(backwards.fit(1, 100).factor, 0.0);
        let (timid, _) = calibration(0.5, 0.0, 0.0);
        assert_eq!(timid.fit(1, 100).factor, 1.0);
    }

    #[test]
    fn only_the_window_before_the_observation_counts() {
        let mut calibration = Calibration::new(SETTINGS);
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let right = comparison(&mut random, 1.0, 0.0);
        let wrong = comparison(&mut random, -1.0, 0.0);
        (0..100).for_each(|index| calibration.add(1, index, wrong));
        (100..150).for_each(|index| calibration.add(1, index, right));
        assert_eq!(
            calibration.fit(1, 99).factor,
            0.0,
            "later frames do not count"
        );
        assert_eq!(
            calibration.fit(1, 149).factor,
            1.0,
            "those before the window do not count"
        );
        let kept = calibration.scored.values().map(BTreeMap::len).max();
        assert!(kept <= Some(SETTINGS.window + SPARE));
        calibration.clear();
        assert_eq!(calibration.fit(1, 149).factor, 1.0);
    }

    #[test]
    fn nan_does_not_count() {
        let mut calibration = Calibration::new(SETTINGS);
        calibration.add(1, 0, Comparison::new(&[0.0], &[f32::NAN], &[1.0]));
        assert_eq!(calibration.fit(1, 0).explained, None);
        assert!(
            Comparison::new(&[0.0], &[f32::NAN], &[1.0])
                .error(1.0)
                .is_nan()
        );
    }
}
