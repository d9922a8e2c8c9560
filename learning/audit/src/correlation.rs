//! Estimation of the lag between two series.

/// Largest shift \[frames\].
pub(crate) const LAG_LIMIT: usize = 10;
const LAGS: usize = 2 * LAG_LIMIT + 1;
/// Standard errors from which a shift is significant.
const SIGNIFICANT: f64 = 3.0;
/// Minimum gain in correlation by a shift.
const GAIN_MIN: f64 = 0.05;

/// Sums of products of two series, at one shift.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    xy: f64,
    xx: f64,
    yy: f64,
    count: usize,
}

impl Sums {
    fn push(&mut self, x: f64, y: f64) {
        if x.is_finite() && y.is_finite() {
            self.xy += x * y;
            self.xx += x * x;
            self.yy += y * y;
            self.count += 1;
        }
    }

    fn correlation(self) -> f64 {
        let magnitude = (self.xx * self.yy).sqrt();
        if magnitude > 1e-12 {
            self.xy / magnitude
        } else {
            0.0
        }
    }
}

/// The lag of the second series behind the first, and its significance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lag {
    /// Lag of the second series \[frames\].
    pub frames: i64,
    /// The correlation at this shift.
    pub correlation: f64,
    /// The correlation without a shift.
    pub unshifted: f64,
    /// Difference of the two correlations in standard errors, by Fisher's z. The number of independent frames is estimated
    /// from the autocorrelations of both series (M. S. Bartlett, JRSS 98, 1935).
    pub score: f64,
    /// The shift with the next best correlation, without neighbours of the best.
    pub second: i64,
    /// Its correlation.
    pub second_correlation: f64,
    /// Number of compared frames.
    pub count: usize,
}

impl Lag {
    /// Finds the best shift between the series of each pair, one pair per episode. Skips values that are not finite. `None` if
    /// a series is constant.
    pub fn of(pairs: &[(Vec<f32>, Vec<f32>)]) -> Option<Self> {
        let mut total = [Sums::default(); LAGS];
        let mut own = [[Sums::default(); LAG_LIMIT]; 2];
        let mut count = 0;
        for (x, y) in pairs {
            let (x, y) = (centred(x), centred(y));
            count += x
                .iter()
                .zip(&y)
                .filter(|(x, y)| x.is_finite() && y.is_finite())
                .count();
            for (index, sums) in total.iter_mut().enumerate() {
                // Only one of the two is shifted.
                let (of_x, of_y) = (
                    LAG_LIMIT.saturating_sub(index),
                    index.saturating_sub(LAG_LIMIT),
                );
                for (x, y) in x.iter().skip(of_x).zip(y.iter().skip(of_y)) {
                    sums.push(*x, *y);
                }
            }
            for (series, all) in [&x, &y].into_iter().zip(&mut own) {
                for (lag, sums) in (1..).zip(all) {
                    for (before, after) in series.iter().zip(series.iter().skip(lag)) {
                        sums.push(*before, *after);
                    }
                }
            }
        }
        let best_of = |is_in: &dyn Fn(usize) -> bool| {
            let correlations = total.iter().map(|sums| sums.correlation()).enumerate();
            let correlations = correlations.filter(|(index, _)| {
                // With few frames left of short episodes, correlations are arbitrary.
                let compared = total.get(*index).map_or(0, |sums| sums.count);
                is_in(*index) && compared * 2 >= count
            });
            correlations.max_by(|(_, a), (_, b)| a.total_cmp(b))
        };
        let (best, correlation) = best_of(&|_| true)?;
        let varies = |sums: &Sums| sums.xx * sums.yy > 1e-12;
        total.get(best).filter(|sums| varies(sums))?;
        let (second, second_correlation) = best_of(&|index| index.abs_diff(best) > 1)?;
        let unshifted = total.get(LAG_LIMIT)?.correlation();
        let [of_x, of_y] = own;
        let repeated: f64 = of_x
            .iter()
            .zip(&of_y)
            .map(|(x, y)| x.correlation() * y.correlation())
            .sum();
        let independent = count as f64 / (1.0 + 2.0 * repeated).max(1.0);
        Some(Self {
            // Fits: at most LAG_LIMIT in either direction.
            frames: best as i64 - LAG_LIMIT as i64,
            correlation,
            unshifted,
            score: score(correlation, unshifted, independent),
            second: second as i64 - LAG_LIMIT as i64,
            second_correlation,
            count,
        })
    }

    /// Whether this shift is significantly better than none.
    pub fn is_significant(&self) -> bool {
        self.score >= SIGNIFICANT && self.correlation - self.unshifted >= GAIN_MIN
    }

    /// The probability that this shift is better than none, by the normal distribution.
    pub fn confidence(&self) -> f64 {
        // M. Abramowitz and I. Stegun, Handbook of Mathematical Functions, 26.2.17: to within 1e-7.
        let t = 1.0 / (1.0 + 0.231_641_9 * self.score);
        let factors = [
            0.319_381_530,
            -0.356_563_782,
            1.781_477_937,
            -1.821_255_978,
            1.330_274_429,
        ];
        let sum = factors
            .iter()
            .rev()
            .fold(0.0, |sum, factor| (sum + factor) * t);
        let density = (-self.score * self.score / 2.0).exp() / std::f64::consts::TAU.sqrt();
        1.0 - density * sum
    }
}

/// Difference of two correlations in standard errors, over this many independent frames.
fn score(a: f64, b: f64, independent: f64) -> f64 {
    let fisher = |correlation: f64| correlation.clamp(-0.9999, 0.9999).atanh();
    let error = (2.0 / (independent - 3.0).max(1e-9)).sqrt();
    (fisher(a) - fisher(b)) / error
}

/// The values minus the mean of the finite ones.
fn centred(values: &[f32]) -> Vec<f64> {
    let finite = || values.iter().filter(|value| value.is_finite());
    let count = finite().count().max(1) as f64;
    let mean = finite().map(|value| f64::from(*value)).sum::<f64>() / count;
    values
        .iter()
        .map(|value| f64::from(*value) - mean)
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// Pseudo-random numbers from 0 to 1.
    fn noise(seed: u64) -> impl FnMut() -> f32 {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 40) as f32 / (1 << 24) as f32
        }
    }

    /// Episodes whose second series lags by `lag` frames and has noise of the same size.
    fn late(episodes: u64, frames: usize, lag: usize) -> Vec<(Vec<f32>, Vec<f32>)> {
        let episode = |seed| {
            let (mut signal, mut own) = (noise(seed), noise(seed + 1000));
            let x: Vec<f32> = (0..frames + lag).map(|_| signal()).collect();
            let y = x.iter().take(frames).map(|x| x + own());
            let y: Vec<f32> = y.collect();
            (x[lag..].to_vec(), y)
        };
        (1..=episodes).map(episode).collect()
    }

    #[test]
    fn lag_is_found_with_its_confidence() {
        for lag in [1, 2, 5] {
            let found = Lag::of(&late(10, 60, lag)).unwrap();
            assert_eq!(found.frames, lag as i64, "{found:?}");
            assert!(
                found.is_significant() && found.correlation > 0.5,
                "{found:?}"
            );
        }
        let none = Lag::of(&late(10, 60, 0)).unwrap();
        assert!(none.frames == 0 && !none.is_significant(), "{none:?}");
    }

    #[test]
    fn unrelated_series_have_no_significant_lag() {
        for seed in 1..40 {
            let (mut a, mut b) = (noise(seed), noise(seed + 77));
            let pair = |_| {
                (
                    (0..50).map(|_| a()).collect(),
                    (0..50).map(|_| b()).collect(),
                )
            };
            let pairs: Vec<(Vec<f32>, Vec<f32>)> = (0..6).map(pair).collect();
            let found = Lag::of(&pairs).unwrap();
            assert!(
                !(found.is_significant() && found.correlation > 0.3),
                "{found:?}"
            );
        }
    }

    #[test]
    fn constant_series_have_no_lag() {
        assert_eq!(Lag::of(&[(vec![1.0; 50], vec![2.0; 50])]), None);
        assert_eq!(Lag::of(&[]), None);
        assert_eq!(Lag::of(&[(vec![f32::NAN; 9], vec![1.0; 9])]), None);
    }

    #[test]
    fn short_episodes_allow_small_shifts_only() {
        for seed in 1..20 {
            let (mut a, mut b) = (noise(seed), noise(seed + 55));
            let pair = |_| ((0..9).map(|_| a()).collect(), (0..9).map(|_| b()).collect());
            let pairs: Vec<(Vec<f32>, Vec<f32>)> = (0..25).map(pair).collect();
            assert!(Lag::of(&pairs).unwrap().frames.abs() <= 4);
        }
    }

    #[test]
    fn slow_series_have_few_independent_frames() {
        let wave = |phase: f32| {
            (0..60)
                .map(|t| (t as f32 * 0.1 + phase).sin())
                .collect::<Vec<f32>>()
        };
        let slow = Lag::of(&[(wave(0.2), wave(0.0))]).unwrap();
        assert_eq!(slow.frames, 2);
        let steps = |lag: usize| late(1, 60, lag).remove(0);
        let quick = Lag::of(&[steps(2)]).unwrap();
        assert!(
            quick.correlation < slow.correlation && quick.score > slow.score,
            "{slow:?} {quick:?}"
        );
    }

    #[test]
    fn confidence_follows_the_normal_distribution() {
        let of = |score| {
            Lag {
                score,
                ..Lag::of(&late(2, 40, 1)).unwrap()
            }
            .confidence()
        };
        for (score, expected) in [(0.0, 0.5), (1.0, 0.841_345), (3.0, 0.998_650)] {
            assert!((of(score) - expected).abs() < 1e-5, "{score}");
        }
    }
}
