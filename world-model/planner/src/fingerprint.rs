//! Whether two processes compute the same.

use candle_core::{Device, Tensor};
use sha2::{Digest as _, Sha256};
use wm_model::{sampler::Sampler, transition::LoadedTransition};

use crate::{Dynamics as _, PlanError, Target, TransitionDynamics};

/// Candidates of the trial: an odd number, so that tiles of all widths have a part in it.
const CANDIDATES: usize = 7;
/// Steps of the trial, so that predictions are a context too.
const STEPS: usize = 2;

/// SHA-256 of latents and costs that the model predicts in a trial that is always the same. Two processes where it is equal
/// have the same weights and round alike: which kernels run, and in which order sums are taken, differs between processors
/// and builds.
///
/// # Errors
/// Where the model fails.
pub fn fingerprint(model: &LoadedTransition) -> Result<[u8; 32], PlanError> {
    let c = model.config();
    let (height, width, channels) = (c.latent_height, c.latent_width, c.channels);
    let context = numbers(&[1, 2, height, width, channels])?;
    let past = numbers(&[1, c.action_dim])?;
    let sampler = Sampler {
        // One is not enough: only from the second on does the network see its own output.
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

/// Numbers from -1 to 1 that are the same everywhere: integers, divided.
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
    fn it_is_the_same_for_the_same_model_only() {
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
