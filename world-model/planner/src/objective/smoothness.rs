//! Cost of changes between actions.

use candle_core::Tensor;

use super::{
    PortableTerm, Term,
    action_size::{half_ranges, mean},
};
use crate::{PlanError, SearchSpace};

/// Mean squared change between consecutive actions, each value as a share of its range, including the change from the
/// action before the plan, if known. Two-valued coordinates do not count.
#[derive(Clone, Copy, Debug)]
pub struct Smoothness;

impl Term for Smoothness {
    fn name(&self) -> &'static str {
        "smoothness"
    }

    fn portable(&self) -> wm_model::Result<Option<PortableTerm>> {
        Ok(Some(PortableTerm::Smoothness))
    }

    fn costs(
        &self,
        space: &SearchSpace,
        candidates: &[Vec<f32>],
        _: &Tensor,
    ) -> Result<Vec<f32>, PlanError> {
        let halves = half_ranges(space);
        let cost = |candidate: &Vec<f32>| {
            let actions = || candidate.chunks_exact(halves.len());
            let first = space.previous().into_iter().chain(actions());
            let next = actions().skip(usize::from(space.previous().is_none()));
            mean(first.zip(next).flat_map(|(from, to)| {
                let pairs = from.iter().zip(to).zip(&halves);
                pairs.filter_map(|((from, to), half)| half.map(|half| (to - from) / half))
            }))
        };
        Ok(candidates.iter().map(cost).collect())
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};

    use super::*;

    #[test]
    fn jumps_within_and_into_the_plan_cost() {
        let latents = Tensor::zeros((2, 2, 1, 1, 1), DType::F32, &Device::Cpu).unwrap();
        let candidates = [vec![1.0, 1.0], vec![1.0, -1.0]];
        let space = SearchSpace::bounded(&[(-2.0, 2.0)], 1).unwrap();
        let alone = Smoothness.costs(&space, &candidates, &latents).unwrap();
        assert_eq!(alone, [0.0, 1.0]);
        let after = space.after(&[-1.0]).unwrap();
        let costs = Smoothness.costs(&after, &candidates, &latents).unwrap();
        assert_eq!(costs, [0.5, 1.0]);
    }
}
