#![allow(clippy::unwrap_used, clippy::indexing_slicing)]
//! A world whose best plan is known.

use candle_core::{Device, Tensor};

use crate::{Dynamics, Objective, Problem, SearchSpace, Target};

/// A point that moves by its actions: the latent (1, 1, A) after step k is the sum of the first k actions.
pub(crate) struct Point {
    pub(crate) values: usize,
    pub(crate) largest_batch: usize,
    /// The latent is NaN if the first action's first value exceeds this.
    pub(crate) cliff: f32,
}

impl Point {
    pub(crate) fn new(values: usize) -> Self {
        Self {
            values,
            largest_batch: 0,
            cliff: f32::INFINITY,
        }
    }
}

impl Dynamics for Point {
    fn action_dim(&self) -> usize {
        self.values
    }

    fn start(&self) -> wm_model::Result<Tensor> {
        Ok(Tensor::zeros(
            (1, 1, self.values),
            candle_core::DType::F32,
            &Device::Cpu,
        )?)
    }

    fn rollout(&mut self, actions: &Tensor) -> wm_model::Result<Tensor> {
        let (count, steps, values) = actions.dims3()?;
        assert_eq!(values, self.values);
        self.largest_batch = self.largest_batch.max(count);
        let mut out = Vec::new();
        for candidate in actions.to_vec3::<f32>()? {
            let mut place = vec![0.0; values];
            let fallen = candidate[0][0] > self.cliff;
            for action in &candidate {
                for (place, delta) in place.iter_mut().zip(action) {
                    *place += delta;
                }
                out.extend(
                    place
                        .iter()
                        .map(|value| if fallen { f32::NAN } else { *value }),
                );
            }
        }
        let shape = (count, steps, 1, 1, values);
        Ok(Tensor::from_vec(out, shape, &Device::Cpu)?)
    }
}

pub(crate) const BOUNDS: [(f32, f32); 2] = [(-1.0, 1.0), (-0.5, 0.5)];

pub(crate) fn bounds() -> SearchSpace {
    SearchSpace::bounded(&BOUNDS, 2).unwrap()
}

/// The distance to a point after the last step.
pub(crate) fn objective(goal: &[f32]) -> Objective {
    let goal = Tensor::from_vec(goal.to_vec(), (1, 1, goal.len()), &Device::Cpu).unwrap();
    Objective::of(Target::LastStep(goal))
}

/// A problem of three steps.
pub(crate) fn problem<'a>(
    space: &'a SearchSpace,
    point: &'a mut Point,
    objective: &'a Objective,
) -> Problem<'a> {
    Problem {
        space,
        dynamics: point,
        objective,
        horizon: 3,
        batch: 64,
        proposals: Vec::new(),
        workers: None,
    }
}
