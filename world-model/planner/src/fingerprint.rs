//! Whether two processes compute the same costs.

use candle_core::{Device, Tensor};
use sha2::{Digest as _, Sha256};
use wm_model::{sampler::Sampler, transition::LoadedTransition};

use crate::{Dynamics as _, PlanError, Target, TransitionDynamics};

/// An odd number, so that tiles of all widths take part.
const CANDIDATES: usize = 7;
/// Two steps, so that a prediction becomes context.
const STEPS: usize = 2;

/// SHA-256 of latents and costs that the model predicts in a fixed trial. Processes with equal fingerprints have the
/// same weights and round alike; kernels and the order of sums differ between processors and builds.
///
/// # Errors
/// If the model fails.
pub fn fingerprint(model: &LoadedTransition) -> Result<[u8; 32], PlanError> {
    let c = model.config();
    let (height, width, channels) = (c.latent_height, c.latent_width, c.channels);
    let context = numbers(&[1, 2, height, width, channels])?;
    let past = numbers(&[1, c.action_dim])?;
    let sampler = Sampler {
        // The network sees its own output from the second step on.
        steps: 2,
        ..c.sampler.clone()
    };
    let mut dynamics = TransitionDynamics::new(model, &sampler, &context, Some(&past), 1)?;
    let latents = dynamics.rollout(&numbers(&[CANDIDATES, STEPS, c.action_dim])?)?;
    let goal = Target::AllSteps(numbers(&[height, width, channels])?);
    let costs = goal.costs(&latents)?;
    let mut hash = Sha256::new();
    for value in latents
        .flatten_all()?
        .to_vec1::<f32>()?
        .iter()
        .chain(&costs)
    {
        hash.update(value.to_le_bytes());
    }
    Ok(hash.finalize().into())
}

/// Fixed numbers from -1 to 1, exact on all machines.
fn numbers(shape: &[usize]) -> Result<Tensor, PlanError> {
    let count = shape.iter().product::<usize>();
    // Below 2^24, exact in f32.
    let number = |i: usize| (i * 7919 % 2003) as f32 / 1001.0 - 1.0;
    let values: Vec<f32> = (0..count).map(number).collect();
    Ok(Tensor::from_vec(values, shape, &Device::Cpu)?)
}

#[cfg(test)]
mod tests {
    use wm_model::transition::{Transition, TransitionConfig};

    use super::*;

    #[test]
    fn fingerprint_identifies_the_model() {
        let model = |seed| {
            let config = TransitionConfig {
                hidden: 64,
                depth: 1,
                heads: 2,
                ..TransitionConfig::preset("tiny", (4, 4, 4), 2, 10).unwrap()
            };
            Transition::random(config, seed).unwrap().pack().unwrap()
        };
        let one = fingerprint(&model(1)).unwrap();
        assert_eq!(fingerprint(&model(1)).unwrap(), one);
        assert_ne!(fingerprint(&model(2)).unwrap(), one);
    }
}
