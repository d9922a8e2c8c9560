//! An axis: its range, scale and ticks.

/// Greatest drawable value; differences of larger ones overflow.
const LIMIT: f64 = 1e100;

/// Maps values to positions.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
    ticks: Vec<f64>,
    step: f64,
}

impl Axis {
    /// Covers `values` and a nearby 0, extended to round numbers; about `count` ticks.
    pub(super) fn of_values(values: impl Iterator<Item = f64>, count: usize) -> Self {
        let (mut low, mut high) = bounds(values);
        if low > 0.0 && low < 0.5 * high {
            low = 0.0;
        }
        if high < 0.0 && high > 0.5 * low {
            high = 0.0;
        }
        let step = step(high - low, count);
        Self::new(
            (low / step).floor() * step,
            (high / step).ceil() * step,
            step,
        )
    }

    /// From the first of `values` to the last. A few integers, such as horizons, get a tick each.
    pub(super) fn of_places(values: impl Iterator<Item = f64>, count: usize) -> Self {
        let mut places: Vec<f64> = values.filter(|value| drawable(*value)).collect();
        places.sort_unstable_by(f64::total_cmp);
        places.dedup();
        let (low, high) = bounds(places.iter().copied());
        let mut axis = Self::new(low, high, step(high - low, count));
        let whole = places.iter().all(|place| place.fract() == 0.0);
        let apart = places.windows(2).all(|pair| match pair {
            [a, b] => b - a >= (high - low) / 16.0,
            _ => false,
        });
        if whole && places.len() > 1 && places.len() <= count * 2 && apart {
            axis.ticks = places;
            axis.step = 1.0;
        }
        axis
    }

    /// Exactly from `low` to `high`.
    pub(super) fn between(low: f64, high: f64, count: usize) -> Self {
        Self::new(low, high, step(high - low, count))
    }

    fn new(low: f64, high: f64, step: f64) -> Self {
        let first = (low / step - 1e-6).ceil();
        // A step is a large part of the span, so 24 ticks suffice.
        let ticks = (0..24).map(|number| (first + f64::from(number)) * step);
        Self {
            low,
            high,
            from: 0.0,
            to: 1.0,
            ticks: ticks
                .take_while(|tick| *tick <= high + step * 1e-6)
                .collect(),
            step,
        }
    }

    /// Draws from position `from` to position `to`.
    pub(super) fn drawn(self, from: f64, to: f64) -> Self {
        Self { from, to, ..self }
    }

    /// Position of a value; `None` if it cannot be drawn.
    pub(super) fn place(&self, value: f64) -> Option<f64> {
        let share = (value - self.low) / (self.high - self.low);
        drawable(value).then_some(self.from + share * (self.to - self.from))
    }

    /// Positions and labels of the ticks.
    pub(super) fn ticks(&self) -> impl Iterator<Item = (f64, String)> {
        let largest = self.low.abs().max(self.high.abs());
        self.ticks.iter().filter_map(move |tick| {
            let place = self.place(*tick)?;
            Some((place, label(*tick, self.step, largest)))
        })
    }
}

pub(super) fn drawable(value: f64) -> bool {
    value.abs() <= LIMIT
}

/// Distinct least and greatest drawable values.
fn bounds(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let values = values.filter(|value| drawable(*value));
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if low > high {
        return (0.0, 1.0);
    }
    if high - low <= high.abs().max(low.abs()) * 1e-9 {
        let room = if high == 0.0 { 1.0 } else { high.abs() * 0.1 };
        return (low - room, high + room);
    }
    (low, high)
}

/// 1, 2 or 5 times a power of ten, for about `count` steps.
fn step(span: f64, count: usize) -> f64 {
    // A handful of ticks.
    let raw = span / count.max(1) as f64;
    let power = 10.0_f64.powf(raw.log10().floor());
    let power = if power > 0.0 { power } else { 1.0 };
    let factor = match raw / power {
        share if share <= 1.0 => 1.0,
        share if share <= 2.0 => 2.0,
        share if share <= 5.0 => 5.0,
        _ => 10.0,
    };
    factor * power
}

fn label(value: f64, step: f64, largest: f64) -> String {
    let (divisor, letter) = match largest {
        size if !(1e-4..1e13).contains(&size) => return format!("{value:.1e}"),
        size if size >= 1e9 => (1e9, "G"),
        size if size >= 1e6 => (1e6, "M"),
        size if size >= 1e4 => (1e3, "k"),
        _ => (1.0, ""),
    };
    let (value, step) = (value / divisor, step / divisor);
    // Between 0 and 8.
    let decimals = (-(step.log10() + 1e-9).floor()).clamp(0.0, 8.0) as usize;
    let text = format!("{value:.decimals$}{letter}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| !matches!(c, '1'..='9')) => rest.to_owned(),
        Some(rest) => format!("−{rest}"),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn texts(axis: &Axis) -> Vec<String> {
        axis.ticks().map(|(_, text)| text).collect()
    }

    #[test]
    fn ticks_are_round() {
        let axis = Axis::of_values([0.12, 0.83].into_iter(), 5);
        assert_eq!(texts(&axis), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        let axis = Axis::of_values([21.3, 25.2].into_iter(), 4);
        assert_eq!(texts(&axis), ["21", "22", "23", "24", "25", "26"]);
        let axis = Axis::of_values([-15_000.0, 12_000.0].into_iter(), 3);
        assert_eq!(texts(&axis), ["−20k", "−10k", "0k", "10k", "20k"]);
        let axis = Axis::of_places([1.0, 2.0, 4.0, 8.0].into_iter(), 6);
        assert_eq!(texts(&axis), ["1", "2", "4", "8"]);
    }

    proptest! {
        #[test]
        fn axis_exists_for_any_values(values in prop::collection::vec(any::<f64>(), 0..8)) {
            for axis in [Axis::of_values(values.iter().copied(), 5), Axis::of_places(values.iter().copied(), 6)] {
                let axis = axis.drawn(10.0, 110.0);
                prop_assert!(axis.ticks().count() <= 24);
                for value in &values {
                    let place = axis.place(*value);
                    prop_assert_eq!(place.is_some(), value.abs() <= LIMIT);
                    prop_assert!(place.is_none_or(|place| (9.9..=110.1).contains(&place)), "{} at {:?} of {:?}", value, place, axis);
                }
            }
        }
    }
}
