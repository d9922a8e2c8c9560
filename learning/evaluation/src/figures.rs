//! Figures with intervals, from the values of units.

use wm_metrics::findings::{Better, Metric};
use wm_metrics::statistics::{Bootstrap, Estimate, bootstrap_mean, replicates};

use crate::Settings;

/// Fewest units with an interval.
pub(crate) const FEWEST: usize = 3;

/// Bootstrap settings of all intervals.
pub(crate) fn draws(settings: &Settings) -> Bootstrap {
    Bootstrap {
        resamples: settings.resamples,
        seed: settings.seed,
        ..Bootstrap::default()
    }
}

/// Mean over units with its bootstrap interval; `None` without units.
pub(crate) fn mean_over_units(
    values: &[(String, f64)],
    settings: &Settings,
    better: Better,
    about: &str,
) -> Option<Metric> {
    let numbers: Vec<f64> = values.iter().map(|(_, value)| *value).collect();
    let estimate = bootstrap_mean(&numbers, &draws(settings)).ok()?;
    Some(Metric {
        interval: (numbers.len() >= FEWEST).then_some(estimate.interval),
        samples: values.iter().cloned().collect(),
        ..Metric::plain(estimate.value, numbers.len(), better, about)
    })
}

/// Any figure of `count` units with its bootstrap interval; `None` if undefined.
pub(crate) fn figure_of_units(
    count: usize,
    settings: &Settings,
    better: Better,
    about: &str,
    figure: impl Fn(&[usize]) -> f64 + Sync,
) -> Option<Metric> {
    let all: Vec<usize> = (0..count).collect();
    let value = figure(&all);
    if !value.is_finite() {
        return None;
    }
    // A resample with an undefined figure (an empty class, or constant values) counts as the whole sample.
    let finite = |chosen: &[usize]| {
        Some(figure(chosen))
            .filter(|v| v.is_finite())
            .unwrap_or(value)
    };
    let draws = draws(settings);
    let replicates = match count >= FEWEST {
        // Fails only for invalid settings; the figure then has no interval.
        true => replicates(count, &draws, finite).unwrap_or_default(),
        false => Vec::new(),
    };
    let estimate = Estimate::of_replicates(value, replicates.clone(), draws.level);
    Some(Metric {
        interval: estimate.ok().map(|estimate| estimate.interval),
        replicates,
        ..Metric::plain(value, count, better, about)
    })
}

/// Indices, in order, of the half of `count` units with the largest `change`.
pub(crate) fn most_changed(count: usize, change: impl Fn(usize) -> Option<f64>) -> Vec<usize> {
    let of = |index: &usize| change(*index).unwrap_or(0.0);
    let mut indices: Vec<usize> = (0..count).collect();
    indices.sort_by(|a, b| of(b).total_cmp(&of(a)));
    indices.truncate(count.div_ceil(2));
    indices.sort_unstable();
    indices
}

/// At most `most` of them, evenly spread.
#[must_use]
pub fn spread<T>(all: Vec<T>, most: usize) -> Vec<T> {
    let count = all.len();
    let most = most.max(1);
    if count <= most {
        return all;
    }
    let mut chosen = (0..most).map(|i| i * count / most).peekable();
    let spread = all.into_iter().enumerate().filter_map(|(index, value)| {
        (chosen.peek() == Some(&index)).then(|| {
            chosen.next();
            value
        })
    });
    spread.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chosen_items_are_spread_evenly() {
        assert_eq!(spread((0..10).collect(), 4), [0, 2, 5, 7]);
        assert_eq!(spread((0..3).collect(), 4), [0, 1, 2]);
        assert_eq!(spread((0..3).collect(), 0), [0]);
        assert!(spread(Vec::<u8>::new(), 2).is_empty());
    }
}
