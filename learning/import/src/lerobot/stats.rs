//! Statistics for LeRobot's normalisation, as in its `compute_stats.py`: per episode, and of all.
//!
//! Two differences are more exact: quantiles are those of the values (linear interpolation, NumPy's default) instead of a
//! histogram's, and all frames and pixels count instead of a sample.

use serde_json::{Value, json};

/// The quantiles and their names.
pub(crate) const QUANTILES: [(&str, f64); 5] = [
    ("q01", 0.01),
    ("q10", 0.10),
    ("q50", 0.50),
    ("q90", 0.90),
    ("q99", 0.99),
];

/// Statistics of a feature, by value or colour channel.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Stats {
    /// Depth of nested lists around each number: 1 for vectors, 3 for pictures (channel, row, column).
    pub depth: usize,
    pub min: Vec<f64>,
    pub max: Vec<f64>,
    pub mean: Vec<f64>,
    /// Of the population (divided by n).
    pub std: Vec<f64>,
    /// In the order of [`QUANTILES`].
    pub quantiles: [Vec<f64>; QUANTILES.len()],
    /// Number of frames.
    pub count: u64,
}

impl Stats {
    fn empty(depth: usize, count: u64) -> Self {
        Self {
            depth,
            min: Vec::new(),
            max: Vec::new(),
            mean: Vec::new(),
            std: Vec::new(),
            quantiles: Default::default(),
            count,
        }
    }

    /// Statistics of concatenated rows of `width` values; at least one row.
    pub fn of_rows(values: &[f64], width: usize) -> Self {
        let width = width.max(1);
        let mut stats = Self::empty(1, (values.len() / width) as u64);
        for column in 0..width {
            let mut sorted: Vec<f64> = values.iter().skip(column).step_by(width).copied().collect();
            sorted.sort_unstable_by(f64::total_cmp);
            let n = sorted.len() as f64;
            let mean = sorted.iter().sum::<f64>() / n;
            let variance = sorted.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
            let at = |rank: u64| {
                // In range: a rank is below the number of values.
                let value = usize::try_from(rank).ok().and_then(|rank| sorted.get(rank));
                value.copied().unwrap_or(f64::NAN)
            };
            stats.push(mean, variance, sorted.len() as u64, at);
        }
        stats
    }

    /// Adds a value's statistics; `at` returns the value of a rank, in ascending order.
    fn push(&mut self, mean: f64, variance: f64, n: u64, at: impl Fn(u64) -> f64) {
        self.min.push(at(0));
        self.max.push(at(n.saturating_sub(1)));
        self.mean.push(mean);
        self.std.push(variance.sqrt());
        for (quantile, (_, share)) in self.quantiles.iter_mut().zip(QUANTILES) {
            let place = share * n.saturating_sub(1) as f64;
            let (low, high) = (at(place.floor() as u64), at(place.ceil() as u64));
            quantile.push(low + (high - low) * place.fract());
        }
    }

    /// Statistics of all episodes, as `aggregate_feature_stats`: quantiles are averages weighted by frames.
    pub fn aggregate(episodes: &[&Self]) -> Option<Self> {
        let first = episodes.first()?;
        let total: u64 = episodes.iter().map(|stats| stats.count).sum();
        let weighted = |value: &dyn Fn(&Self) -> Option<f64>| {
            let sum: f64 = episodes
                .iter()
                .map(|stats| value(stats).unwrap_or(f64::NAN) * stats.count as f64)
                .sum();
            sum / total as f64
        };
        let mut all = Self::empty(first.depth, total);
        for column in 0..first.mean.len() {
            let of = |values: &[f64]| values.get(column).copied();
            let fold = |values: &dyn Fn(&Self) -> Option<f64>, pick: fn(f64, f64) -> f64| {
                episodes.iter().filter_map(|s| values(s)).reduce(pick)
            };
            let mean = weighted(&|stats| of(&stats.mean));
            let variance = weighted(&|stats| {
                Some(of(&stats.std)?.powi(2) + (of(&stats.mean)? - mean).powi(2))
            });
            all.min.extend(fold(&|stats| of(&stats.min), f64::min));
            all.max.extend(fold(&|stats| of(&stats.max), f64::max));
            all.mean.push(mean);
            all.std.push(variance.sqrt());
            for (number, quantile) in all.quantiles.iter_mut().enumerate() {
                quantile.push(weighted(&|stats| of(stats.quantiles.get(number)?)));
            }
        }
        Some(all)
    }

    /// Names and numbers of the statistics, without the count.
    pub fn named(&self) -> impl Iterator<Item = (&'static str, &Vec<f64>)> {
        let moments = [
            ("min", &self.min),
            ("max", &self.max),
            ("mean", &self.mean),
            ("std", &self.std),
        ];
        let names = QUANTILES.iter().map(|(name, _)| *name);
        moments.into_iter().chain(names.zip(&self.quantiles))
    }

    /// The form in `meta/stats.json`.
    pub fn to_json(&self) -> Value {
        let nest =
            |value: &f64| (1..self.depth).fold(json!(value), |inner, _| Value::Array(vec![inner]));
        let named = self.named().map(|(name, values)| {
            (
                name.to_owned(),
                Value::Array(values.iter().map(nest).collect()),
            )
        });
        let count = ("count".to_owned(), json!([self.count]));
        Value::Object(named.chain([count]).collect())
    }
}

/// Counts of the 256 values of each colour channel, which determine all statistics of pictures.
#[derive(Clone, Debug)]
pub(crate) struct Histogram {
    channels: [[u64; 256]; 3],
    frames: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            channels: [[0; 256]; 3],
            frames: 0,
        }
    }
}

impl Histogram {
    /// Counts a frame's pixels, interleaved R G B.
    pub fn add(&mut self, rgb: &[u8]) {
        let [red, green, blue] = &mut self.channels;
        for pixel in rgb.as_chunks::<3>().0 {
            for (counts, value) in [&mut *red, green, blue].into_iter().zip(pixel) {
                if let Some(count) = counts.get_mut(usize::from(*value)) {
                    *count += 1;
                }
            }
        }
        self.frames += 1;
    }

    /// The statistics, for values from 0 to 1.
    pub fn stats(&self) -> Stats {
        let mut stats = Stats::empty(3, self.frames);
        for counts in &self.channels {
            let n: u64 = counts.iter().sum();
            let moment = |f: &dyn Fn(f64) -> f64| {
                let values = (0..)
                    .zip(counts)
                    .map(|(value, count): (u32, _)| f(f64::from(value) / 255.0) * *count as f64);
                values.sum::<f64>() / n as f64
            };
            let mean = moment(&|value| value);
            let variance = moment(&|value| (value - mean).powi(2));
            let at = |rank: u64| {
                let mut below = 0;
                let value = counts.iter().position(|count| {
                    below += count;
                    below > rank
                });
                value.map_or(f64::NAN, |value| value as f64 / 255.0)
            };
            stats.push(mean, variance, n, at);
        }
        stats
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn quantiles_equal_numpys() {
        // numpy.quantile([1, 2, 3, 4, 10], [.01, .1, .5, .9, .99])
        let stats = Stats::of_rows(&[10.0, 3.0, 1.0, 4.0, 2.0], 1);
        for (got, expected) in stats.quantiles.iter().zip([1.04, 1.4, 3.0, 7.6, 9.76]) {
            assert!((got[0] - expected).abs() < 1e-12, "{got:?} {expected}");
        }
        assert_eq!(
            (stats.mean[0], stats.min[0], stats.max[0]),
            (4.0, 1.0, 10.0)
        );
        assert!((stats.std[0] - 10f64.sqrt()).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn histogram_statistics_equal_those_of_pixels(pixels in prop::collection::vec(any::<[u8; 3]>(), 1..60)) {
            let mut histogram = Histogram::default();
            histogram.add(pixels.as_flattened());
            let values: Vec<f64> = pixels.iter().flatten().map(|value| f64::from(*value) / 255.0).collect();
            let (by_count, by_value) = (histogram.stats(), Stats::of_rows(&values, 3));
            prop_assert_eq!(by_count.count, 1);
            for ((name, a), (_, b)) in by_count.named().zip(by_value.named()) {
                for (a, b) in a.iter().zip(b) {
                    prop_assert!((a - b).abs() < 1e-9, "{}: {} {}", name, a, b);
                }
            }
        }

        #[test]
        fn aggregated_moments_equal_those_of_the_whole(
            values in prop::collection::vec(-1e3f64..1e3, 2..80), share in 0.01f64..0.99,
        ) {
            let cut = ((values.len() as f64 * share) as usize).clamp(1, values.len() - 1);
            let (a, b) = (Stats::of_rows(&values[..cut], 1), Stats::of_rows(&values[cut..], 1));
            let (parts, whole) = (Stats::aggregate(&[&a, &b]).unwrap(), Stats::of_rows(&values, 1));
            prop_assert_eq!(parts.count, whole.count);
            prop_assert!((parts.mean[0] - whole.mean[0]).abs() < 1e-8);
            prop_assert!((parts.std[0] - whole.std[0]).abs() < 1e-8);
            prop_assert_eq!((parts.min[0], parts.max[0]), (whole.min[0], whole.max[0]));
        }
    }
}
