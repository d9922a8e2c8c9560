//! Cost of imagined episodes that do not follow an instruction.

use std::sync::Arc;

use candle_core::Tensor;
use wm_zoo::success_probe::{Instruction, SuccessClassifier};

use super::Term;
use crate::{PlanError, SearchSpace};

/// One minus the success probe's probability that the observed and imagined frames follow the instruction.
#[derive(Clone, Debug)]
pub struct Success {
    probe: Arc<SuccessClassifier>,
    instruction: Instruction,
    /// (H, h, w, C), normalised.
    observed: Tensor,
}

impl Success {
    /// The term for an encoded `instruction` and the `observed` latents (H, h, w, C), oldest first.
    pub fn new(probe: Arc<SuccessClassifier>, instruction: Instruction, observed: Tensor) -> Self {
        Self {
            probe,
            instruction,
            observed,
        }
    }
}

impl Term for Success {
    fn name(&self) -> &'static str {
        "success"
    }

    fn costs(
        &self,
        _: &SearchSpace,
        _: &[Vec<f32>],
        latents: &Tensor,
    ) -> Result<Vec<f32>, PlanError> {
        let of_one = |index| {
            let episode = Tensor::cat(&[&self.observed, &latents.get(index)?], 0)?;
            let probability = self.probe.probability(&episode, &self.instruction);
            Ok(1.0 - probability.map_err(wm_model::Error::from)?)
        };
        (0..latents.dim(0)?).map(of_one).collect()
    }
}
