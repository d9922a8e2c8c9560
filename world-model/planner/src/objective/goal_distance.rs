//! Distance of predicted latents to a goal.

use candle_core::{D, Tensor};
use serde::{Deserialize, Serialize};
use wm_model::{Error, LatentSpace};

use super::{PortableTerm, Term};
use crate::{Array, PlanError, SearchSpace};

/// Latents that predictions are compared with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Target<L = Tensor> {
    /// One latent per step (k, h, w, C); the cost is the mean over all k steps. The objective of the controllability
    /// metric.
    EachStep(L),
    /// One latent (h, w, C) for the last step; the path is free.
    LastStep(L),
    /// One latent (h, w, C) for all steps. The cost is the mean, so an early arrival costs less.
    AllSteps(L),
    /// Latents (h, w, C) with the index of their step, from 0. An index beyond the plan means its last step. The cost
    /// is the mean.
    At(Vec<(usize, L)>),
}

impl<L> Target<L> {
    /// Converts the latents.
    fn try_map<M, E>(&self, of: impl Fn(&L) -> Result<M, E>) -> Result<Target<M>, E> {
        Ok(match self {
            Self::EachStep(latents) => Target::EachStep(of(latents)?),
            Self::LastStep(latent) => Target::LastStep(of(latent)?),
            Self::AllSteps(latent) => Target::AllSteps(of(latent)?),
            Self::At(latents) => {
                let each = latents
                    .iter()
                    .map(|(step, latent)| Ok((*step, of(latent)?)));
                Target::At(each.collect::<Result<_, E>>()?)
            }
        })
    }
}

impl Target {
    /// The values of a latent of `space`, row-major with channels last, for the last step.
    ///
    /// # Errors
    /// If it has another number of values than the space.
    pub fn last_step(space: &LatentSpace, latent: &[f32]) -> wm_model::Result<Self> {
        Ok(Self::LastStep(space.stack(&[latent])?.squeeze(0)?))
    }

    /// As [`Self::costs`], of candidates of one step: `latents` of `space`, one for each.
    ///
    /// # Errors
    /// As there; or if one has another number of values than the space.
    pub fn step_costs(
        &self,
        space: &LatentSpace,
        latents: &[&[f32]],
    ) -> wm_model::Result<Vec<f32>> {
        self.costs(&space.stack(latents)?.unsqueeze(1)?)
    }

    /// Mean squared latent error of each candidate: `latents` (N, k, h, w, C) to N costs, in normalised units squared.
    /// A cost may be NaN or infinite where the model's latents are.
    ///
    /// # Errors
    /// [`Error::Shape`] if target and latents differ in shape.
    pub fn costs(&self, latents: &Tensor) -> wm_model::Result<Vec<f32>> {
        self.weighted(latents, None)
    }

    fn weighted(&self, latents: &Tensor, mask: Option<&Tensor>) -> wm_model::Result<Vec<f32>> {
        let (_, steps, height, width, channels) = latents.dims5()?;
        let last = steps.saturating_sub(1);
        let at = |target: &Tensor, step: usize| -> wm_model::Result<Tensor> {
            expect(target, &[height, width, channels])?;
            let step = latents.narrow(1, step.min(last), 1)?;
            squared(&step, &target.unsqueeze(0)?, mask)
        };
        let costs = match self {
            Self::EachStep(target) => {
                expect(target, &[steps, height, width, channels])?;
                squared(latents, target, mask)?
            }
            Self::LastStep(target) => at(target, last)?,
            Self::AllSteps(target) => {
                expect(target, &[height, width, channels])?;
                squared(latents, &target.unsqueeze(0)?, mask)?
            }
            Self::At(targets) => {
                let each = targets.iter().map(|(step, target)| at(target, *step));
                let each = each.collect::<wm_model::Result<Vec<_>>>()?;
                if each.is_empty() {
                    return Err(Error::config("target", "no latent to reach"));
                }
                Tensor::stack(&each, 1)?.mean(D::Minus1)?
            }
        };
        Ok(costs.to_vec1::<f32>()?)
    }
}

/// Mean squared error (N) of latents (N, k, h, w, C) to a target (1 or k, h, w, C), weighted by a mask (h, w, 1) of mean 1.
fn squared(latents: &Tensor, target: &Tensor, mask: Option<&Tensor>) -> wm_model::Result<Tensor> {
    let mut error = latents.broadcast_sub(&target.unsqueeze(0)?)?.sqr()?;
    if let Some(mask) = mask {
        error = error.broadcast_mul(mask)?;
    }
    Ok(error.flatten_from(1)?.mean(D::Minus1)?)
}

fn expect(target: &Tensor, shape: &[usize]) -> wm_model::Result<()> {
    if target.dims() == shape {
        return Ok(());
    }
    Err(Error::Shape {
        what: "the planner's target",
        expected: format!("{shape:?}"),
        found: target.dims().to_vec(),
    })
}

/// Mean squared latent error to a target, over the whole picture or a region.
#[derive(Clone, Debug)]
pub struct GoalDistance {
    name: &'static str,
    target: Target,
    /// (h, w, 1), of mean 1.
    mask: Option<Tensor>,
}

impl GoalDistance {
    /// The distance to `target` over the whole picture.
    pub fn new(target: Target) -> Self {
        Self {
            name: "goal",
            target,
            mask: None,
        }
    }

    /// Renames the term, for objectives with several distances.
    #[must_use]
    pub fn named(self, name: &'static str) -> Self {
        Self { name, ..self }
    }

    /// Weighs each place of the picture by `mask` (h, w).
    ///
    /// # Errors
    /// [`PlanError::Setting`] if no value is above 0, or one is negative or not finite. [`Term::costs`] checks the
    /// shape.
    pub fn within(self, mask: &Tensor) -> Result<Self, PlanError> {
        let (height, width) = mask.dims2().map_err(wm_model::Error::from)?;
        let values = mask.flatten_all()?.to_vec1::<f32>()?;
        let sum: f64 = values.iter().map(|value| f64::from(*value)).sum();
        let is_sound = values
            .iter()
            .all(|value| value.is_finite() && *value >= 0.0);
        if !is_sound || sum <= 0.0 {
            return Err(PlanError::Setting(
                "the goal's mask must be finite, not negative, and above 0 somewhere".into(),
            ));
        }
        // Counts stay far below 2^52.
        let mean = sum / values.len() as f64;
        let mask = (mask / mean)?.reshape((height, width, 1))?;
        Ok(Self {
            mask: Some(mask),
            ..self
        })
    }
}

impl GoalDistance {
    /// The inverse of [`Term::portable`].
    pub(super) fn of_portable(
        target: &Target<Array>,
        mask: Option<&Array>,
    ) -> wm_model::Result<Self> {
        Ok(Self {
            mask: mask.map(Array::tensor).transpose()?,
            ..Self::new(target.try_map(Array::tensor)?)
        })
    }
}

impl Term for GoalDistance {
    fn name(&self) -> &'static str {
        self.name
    }

    fn portable(&self) -> wm_model::Result<Option<PortableTerm>> {
        Ok(Some(PortableTerm::GoalDistance {
            target: self.target.try_map(Array::of)?,
            mask: self.mask.as_ref().map(Array::of).transpose()?,
        }))
    }

    fn costs(
        &self,
        _: &SearchSpace,
        _: &[Vec<f32>],
        latents: &Tensor,
    ) -> Result<Vec<f32>, PlanError> {
        if let Some(mask) = &self.mask {
            let (_, _, height, width, _) = latents.dims5()?;
            if mask.dims() != [height, width, 1] {
                return Err(Error::Shape {
                    what: "the goal's mask",
                    expected: format!("[{height}, {width}]"),
                    found: mask.dims().iter().copied().take(2).collect(),
                }
                .into());
            }
        }
        Ok(self.target.weighted(latents, self.mask.as_ref())?)
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    fn tensor(values: &[f32], shape: &[usize]) -> Tensor {
        Tensor::from_vec(values.to_vec(), shape, &Device::Cpu).unwrap()
    }

    #[test]
    fn each_target_counts_its_own_steps() {
        let latents = tensor(&[0.0, 2.0, 1.0, 4.0], &[2, 2, 1, 1, 1]);
        let costs = |target: Target| target.costs(&latents).unwrap();
        let each = tensor(&[0.0, 1.0], &[2, 1, 1, 1]);
        assert_eq!(costs(Target::EachStep(each)), [0.5, 5.0]);
        let one = tensor(&[1.0], &[1, 1, 1]);
        assert_eq!(costs(Target::LastStep(one.clone())), [1.0, 9.0]);
        assert_eq!(costs(Target::AllSteps(one.clone())), [1.0, 4.5]);
        let two = tensor(&[2.0], &[1, 1, 1]);
        assert_eq!(
            costs(Target::At(vec![(0, one.clone()), (9, two)])),
            [0.5, 2.0]
        );
        let message = Target::EachStep(one)
            .costs(&latents)
            .unwrap_err()
            .to_string();
        assert!(message.contains("[2, 1, 1, 1]"), "{message}");
        assert!(Target::At(vec![]).costs(&latents).is_err());
    }

    #[test]
    fn places_outside_the_mask_do_not_count() {
        let latents = tensor(&[3.0, 1.0], &[1, 1, 1, 2, 1]);
        let goal = Target::LastStep(tensor(&[0.0, 0.0], &[1, 2, 1]));
        let space = SearchSpace::bounded(&[(-1.0, 1.0)], 1).unwrap();
        let costs = |term: &GoalDistance| term.costs(&space, &[vec![0.0]], &latents);
        let whole = GoalDistance::new(goal);
        assert_eq!(costs(&whole).unwrap(), [5.0]);
        let right = whole.clone().within(&tensor(&[0.0, 1.0], &[1, 2])).unwrap();
        assert_eq!(costs(&right).unwrap(), [1.0]);
        assert!(whole.clone().within(&tensor(&[0.0, 0.0], &[1, 2])).is_err());
        assert!(
            whole
                .clone()
                .within(&tensor(&[-1.0, 2.0], &[1, 2]))
                .is_err()
        );
        let wrong = whole.within(&tensor(&[1.0], &[1, 1])).unwrap();
        let message = costs(&wrong).unwrap_err().to_string();
        assert!(
            message.contains("mask") && message.contains("[1, 2]"),
            "{message}"
        );
    }
}
