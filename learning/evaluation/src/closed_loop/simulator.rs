//! The simulator as a perfect model.

use candle_core::Tensor;
use wm_model::{Error, Result};
use wm_planner::Dynamics;
use wm_sim::Environment;

use super::model::Model;

/// Perfect dynamics: each candidate runs on a copy of the table, and its pictures are encoded.
pub struct Simulator<'a> {
    pub environment: Environment,
    pub model: &'a Model,
    /// Current observation (h, w, C).
    pub observed: Tensor,
}

impl Simulator<'_> {
    fn imagine(&mut self, actions: &Tensor) -> anyhow::Result<Tensor> {
        let mut candidates = Vec::new();
        for candidate in actions.to_vec3::<f32>()? {
            let mut world = self.environment.world().clone();
            let mut latents = Vec::with_capacity(candidate.len());
            for action in &candidate {
                for command in self.model.commands(action)? {
                    world.step(&command);
                }
                let picture = self.environment.picture_of(&world);
                latents.push(self.model.encode(&picture)?);
            }
            candidates.push(Tensor::stack(&latents, 0)?);
        }
        Ok(Tensor::stack(&candidates, 0)?)
    }
}

impl Dynamics for Simulator<'_> {
    fn action_dim(&self) -> usize {
        self.model.world.encoding.action_dim()
    }

    fn start(&self) -> Result<Tensor> {
        Ok(self.observed.clone())
    }

    fn rollout(&mut self, actions: &Tensor) -> Result<Tensor> {
        let found = self.imagine(actions);
        found.map_err(|error| Error::config("the simulator as a model", format!("{error:#}")))
    }
}
