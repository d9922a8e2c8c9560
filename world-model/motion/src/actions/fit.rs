//! Fits the scales of an action space to recorded values.

use super::{ActionError, ActionSpace, Dimension, Kind, limits::Unit};

/// Greatest magnitude of a fitted dimension in model units. The outer quantiles map to 1; a slightly faster robot is
/// not yet clipped.
const CLIP: f32 = 1.5;
/// Least part of the whole range that maps to -1 to 1. Of a value that rarely moves, the quantiles 0.01 and 0.99 span
/// noise only.
const LEAST_OF_WHOLE: f64 = 0.2;
/// Least range relative to the widest one of the same kind and unit.
const LEAST_OF_WIDEST: f64 = 0.1;
/// Least range of states \[m, rad\], and of motions \[m/s, rad/s\]: smaller ones are noise of encoders.
const LEAST_SI: f64 = 2e-3;
/// Least range of states in unknown units, relative to their magnitude.
const LEAST_OF_MAGNITUDE: f64 = 1e-3;
/// Rounding errors of constants.
const CONSTANT: f64 = 1e-9;

/// Quantiles of one value over a data set.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// Quantile 0.001.
    pub least: f64,
    /// Quantile 0.01.
    pub low: f64,
    /// Quantile 0.99.
    pub high: f64,
    /// Quantile 0.999.
    pub most: f64,
}

impl Spread {
    /// The spread of values, in any order; `None` without values. Quantiles are interpolated linearly, NumPy's default.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f32>) -> Option<Self> {
        let mut sorted: Vec<f64> = values.into_iter().map(f64::from).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        Some(Self {
            least: quantile(&sorted, 0.001)?,
            low: quantile(&sorted, 0.01)?,
            high: quantile(&sorted, 0.99)?,
            most: quantile(&sorted, 0.999)?,
        })
    }

    fn magnitude(&self) -> f64 {
        self.least.abs().max(self.most.abs())
    }
}

/// The value below which the share `share` of the ascending values lies, interpolated; `None` without values.
fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let place = share * sorted.len().checked_sub(1)? as f64;
    // Not negative, and at most the last index.
    let low = sorted.get(place.floor() as usize)?;
    let high = sorted.get(place.ceil() as usize)?;
    Some(low + (high - low) * place.fract())
}

impl ActionSpace {
    /// The space with scales, offsets and clips fitted to recorded values, one spread per dimension.
    ///
    /// The quantiles 0.01 and 0.99 map to -1 and 1; for a delta or a velocity, the one farther from 0 maps to -1 or 1.
    /// A continuous gripper maps its quantiles 0.001 and 0.999 to closed and open. The range of -1 to 1 is widened, so
    /// that no noise is amplified and no rare motion is lost, to
    /// - a fifth of the range between the quantiles 0.001 and 0.999,
    /// - a tenth of the widest range of the same kind and unit, if the unit is known,
    /// - 0.002 m or rad (per second for motions), or a thousandth of the magnitude of a state in an unknown unit.
    ///
    /// Binary grippers and constant values keep their scales.
    ///
    /// # Errors
    /// [`ActionError::Space`] if a range is too narrow for any scale.
    pub fn fitted(&self, spreads: &[Spread]) -> Result<Self, ActionError> {
        let pairs = || self.dimensions().iter().zip(spreads);
        let ranges: Vec<(Option<f64>, &Dimension)> = pairs()
            .map(|(dimension, spread)| (range(dimension, spread, self.rate()), dimension))
            .collect();
        let widest = |dimension: &Dimension| {
            let alike = ranges.iter().filter(|(_, other)| {
                (other.kind, &other.unit) == (dimension.kind, &dimension.unit)
            });
            alike.filter_map(|(range, _)| *range).fold(0.0, f64::max)
        };
        let mut dimensions = self.dimensions().to_vec();
        for ((dimension, spread), (range, _)) in dimensions.iter_mut().zip(spreads).zip(&ranges) {
            let Some(mut range) = *range else { continue };
            let is_known = Unit::parse(&dimension.unit).is_some();
            if is_known && !dimension.kind.is_gripper() {
                range = range.max(LEAST_OF_WIDEST * widest(dimension));
            }
            let offset = match dimension.kind {
                Kind::GripperContinuous => spread.least,
                kind if kind.is_motion() => 0.0,
                _ => f64::midpoint(spread.low, spread.high),
            };
            // Model actions are f32.
            dimension.offset = offset as f32;
            dimension.scale = (1.0 / range) as f32;
            dimension.clip = CLIP;
        }
        Self::new(self.name().to_owned(), self.rate(), dimensions)
    }
}

/// The value that maps to 1, counted from the offset; `None` to keep the scale. `rate` is that of deltas \[Hz\].
fn range(dimension: &Dimension, spread: &Spread, rate: f64) -> Option<f64> {
    let width = spread.most - spread.least;
    let is_motion = dimension.kind.is_motion();
    let (own, whole) = match dimension.kind {
        Kind::GripperBinary => return None,
        Kind::GripperContinuous => (width, width),
        _ if is_motion => (spread.low.abs().max(spread.high.abs()), spread.magnitude()),
        _ => ((spread.high - spread.low) / 2.0, width / 2.0),
    };
    if whole <= CONSTANT {
        return None;
    }
    if dimension.kind.is_gripper() {
        return Some(own);
    }
    let least = match Unit::parse(&dimension.unit) {
        Some(Unit::Length(si) | Unit::Angle(si)) => {
            let seconds = if dimension.kind.is_delta() { rate } else { 1.0 };
            LEAST_SI / si / seconds
        }
        None if is_motion => 0.0,
        None => LEAST_OF_MAGNITUDE * spread.magnitude(),
    };
    Some(own.max(LEAST_OF_WHOLE * whole).max(least))
}

#[cfg(test)]
mod tests;
