//! Subgoals as the goals of a plan's steps.

use candle_core::Tensor;
use wm_zoo::subgoals::{SubgoalSampling, TrainedSubgoals};

use crate::{Goals, PlanError};

/// Latents (h, w, C) proposed on the way to a goal, each with its distance in model steps, nearest first.
#[derive(Clone, Debug, Default)]
pub struct Subgoals(Vec<(usize, Tensor)>);

impl Subgoals {
    /// The subgoals on the way from `present` to `goal`, both (h, w, C), normalised.
    ///
    /// # Errors
    /// If a latent does not fit the model.
    pub fn propose(
        model: &TrainedSubgoals,
        (present, goal): (&Tensor, &Tensor),
        sampling: SubgoalSampling,
    ) -> Result<Self, PlanError> {
        let latents = model.propose(present, goal, sampling);
        let latents = latents.map_err(wm_model::Error::from)?;
        let distances = model.distances().iter().copied();
        Ok(Self(distances.zip(latents).collect()))
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The goals of `horizon` model steps: each step aims at the first subgoal that is not behind it, and at the last one
    /// if there is none.
    pub fn goals(&self, horizon: usize) -> Goals {
        let of_step = |step: usize| {
            let ahead = self.0.iter().find(|(distance, _)| *distance >= step);
            ahead.or(self.0.last()).map(|(_, latent)| latent.clone())
        };
        Goals::from((1..=horizon).filter_map(of_step).collect::<Vec<_>>())
    }

    /// Distances in model steps, and values, row-major with channels last.
    ///
    /// # Errors
    /// If a value cannot be read.
    pub fn values(&self) -> Result<Vec<(usize, Vec<f32>)>, PlanError> {
        let values = |(distance, latent): &(usize, Tensor)| {
            Ok((*distance, latent.flatten_all()?.to_vec1::<f32>()?))
        };
        self.0.iter().map(values).collect()
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    fn subgoals(distances: &[usize]) -> Subgoals {
        let latent = |distance: &usize| Tensor::new(&[[[*distance as f32]]], &Device::Cpu).unwrap();
        let each = distances.iter();
        Subgoals(each.map(|distance| (*distance, latent(distance))).collect())
    }

    fn goals(distances: &[usize], horizon: usize) -> Vec<f32> {
        let goals = subgoals(distances).goals(horizon);
        let value = |latent: &Tensor| latent.flatten_all().unwrap().to_vec1::<f32>().unwrap()[0];
        goals.latents().iter().map(value).collect()
    }

    #[test]
    fn each_step_aims_at_the_next_subgoal() {
        assert_eq!(goals(&[1, 2, 4], 6), [1.0, 2.0, 4.0, 4.0, 4.0, 4.0]);
        assert_eq!(goals(&[2], 2), [2.0, 2.0]);
        assert!(goals(&[], 3).is_empty());
    }
}
