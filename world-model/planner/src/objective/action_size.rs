//! Cost of large actions.

use candle_core::Tensor;

use super::{PortableTerm, Term};
use crate::{PlanError, Range, SearchSpace};

/// Mean squared size of the actions, each value as a share of its range: 0 for no motion, 1 at the bounds. Two-valued
/// coordinates do not count.
#[derive(Clone, Copy, Debug)]
pub struct ActionSize;

impl Term for ActionSize {
    fn name(&self) -> &'static str {
        "action"
    }

    fn portable(&self) -> wm_model::Result<Option<PortableTerm>> {
        Ok(Some(PortableTerm::ActionSize))
    }

    fn costs(
        &self,
        space: &SearchSpace,
        candidates: &[Vec<f32>],
        _: &Tensor,
    ) -> Result<Vec<f32>, PlanError> {
        let halves = half_ranges(space);
        let cost = |candidate: &Vec<f32>| {
            let actions = candidate.chunks_exact(halves.len());
            mean(actions.flat_map(|action| {
                let pairs = action.iter().zip(&halves);
                pairs.filter_map(|(value, half)| half.map(|half| value / half))
            }))
        };
        Ok(candidates.iter().map(cost).collect())
    }
}

/// Half the range of each value; `None` for a two-valued or fixed one.
pub(super) fn half_ranges(space: &SearchSpace) -> Vec<Option<f32>> {
    let half = |range| match range {
        Range::Between(low, high) if high > low => Some((high - low) / 2.0),
        _ => None,
    };
    let coordinates = space.coordinates().iter();
    coordinates
        .map(|coordinate| half(coordinate.range))
        .collect()
}

/// Mean of squares; 0 if empty.
pub(super) fn mean(values: impl Iterator<Item = f32>) -> f32 {
    let (sum, count) = values.fold((0.0_f64, 0_u32), |(sum, count), value| {
        (sum + f64::from(value).powi(2), count + 1)
    });
    (sum / f64::from(count.max(1))) as f32
}
