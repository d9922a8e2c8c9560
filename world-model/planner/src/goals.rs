//! Latents to reach.

use candle_core::Tensor;
use wm_model::LatentSpace;
use wm_zoo::distance::TrainedDistance;

use crate::{PlanError, objective::steps_to_goal};

/// Latents (h, w, C) to reach, in their order.
#[derive(Clone, Debug, Default)]
pub struct Goals(Vec<Tensor>);

impl Goals {
    /// Latents of `space`, each row-major with channels last.
    ///
    /// # Errors
    /// If one has another number of values than the space.
    pub fn of_values(space: &LatentSpace, latents: &[&[f32]]) -> wm_model::Result<Self> {
        let each = latents.iter().map(|latent| {
            let latent = space.stack(&[latent])?;
            Ok(latent.squeeze(0)?)
        });
        each.collect::<wm_model::Result<_>>().map(Self)
    }

    /// The latents.
    pub fn latents(&self) -> &[Tensor] {
        &self.0
    }

    /// Whether they are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The goals of `horizon` model steps if each of these from number `first` on is reached by one step; the last one is
    /// the goal of all steps thereafter.
    #[must_use]
    pub fn one_per_step(&self, first: usize, horizon: usize) -> Self {
        // Without a goal of that number, no step has one.
        Self(one_per_step(self.0.get(first..).unwrap_or(&[]), horizon))
    }

    /// Those of these numbers that exist.
    #[must_use]
    pub fn at(&self, indices: &[usize]) -> Self {
        let of_index = |index: &usize| self.0.get(*index).cloned();
        Self(indices.iter().filter_map(of_index).collect())
    }

    /// Mean squared error of the last of these to the only one of `other`, in normalised units squared; NaN if there is
    /// none.
    ///
    /// # Errors
    /// If shapes differ.
    pub fn distance(&self, other: &Self) -> Result<f32, PlanError> {
        match (self.0.last(), other.0.last()) {
            (Some(goal), Some(observed)) => latent_distance(observed, goal),
            _ => Ok(f32::NAN),
        }
    }

    /// Model steps to the last of these from the only one of `other`, by a learnt distance (its median); NaN if there is
    /// none.
    ///
    /// # Errors
    /// If shapes do not fit.
    pub fn steps_from(&self, other: &Self, learnt: &TrainedDistance) -> Result<f32, PlanError> {
        match (self.0.last(), other.0.last()) {
            (Some(goal), Some(observed)) => {
                let steps = steps_to_goal(learnt, &observed.unsqueeze(0)?, goal)?;
                Ok(steps.first().copied().unwrap_or(f32::NAN))
            }
            _ => Ok(f32::NAN),
        }
    }
}

impl From<Vec<Tensor>> for Goals {
    fn from(latents: Vec<Tensor>) -> Self {
        Self(latents)
    }
}

/// The goals of `horizon` model steps, where each is reached by one step: the last one is that of all that follow.
pub fn one_per_step(goals: &[Tensor], horizon: usize) -> Vec<Tensor> {
    let last = goals.last();
    let of_step = |step| goals.get(step).or(last).cloned();
    (0..horizon).filter_map(of_step).collect()
}

/// Mean squared error of two latents of one shape, in normalised units squared.
///
/// # Errors
/// Where shapes differ.
pub(crate) fn latent_distance(a: &Tensor, b: &Tensor) -> Result<f32, PlanError> {
    Ok((a - b)?.sqr()?.mean_all()?.to_scalar::<f32>()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_goal_holds_for_all_later_steps() {
        let space = LatentSpace {
            name: "small".to_owned(),
            hash: String::new(),
            height: 1,
            width: 1,
            channels: 2,
        };
        let goals = Goals::of_values(&space, &[&[1.0, 1.0], &[2.0, 2.0], &[3.0, 3.0]]).unwrap();
        let firsts = |goals: &Goals| -> Vec<f32> {
            let first = |latent: &Tensor| latent.flatten_all().unwrap().to_vec1().unwrap()[0];
            goals.latents().iter().map(first).collect()
        };
        assert_eq!(firsts(&goals.one_per_step(1, 3)), [2.0, 3.0, 3.0]);
        assert!(goals.one_per_step(3, 3).is_empty());
        assert_eq!(firsts(&goals.at(&[2, 0, 7])), [3.0, 1.0]);
        let observed = Goals::of_values(&space, &[&[1.0, 3.0]]).unwrap();
        assert_eq!(goals.distance(&observed).unwrap(), 2.0);
        assert!(goals.distance(&Goals::default()).unwrap().is_nan());
        assert!(Goals::of_values(&space, &[&[1.0]]).is_err());
    }
}
