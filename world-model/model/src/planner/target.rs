//! What a plan is to reach.

use candle_core::{D, Tensor};

use crate::Error;

/// The latents that the predicted ones are compared with.
#[derive(Clone, Debug)]
pub enum Target {
    /// One latent a step (k, h, w, C): the cost is the mean over all k steps. The objective of the controllability metric.
    EachStep(Tensor),
    /// One latent (h, w, C) for the last step; how the plan comes there is free.
    LastStep(Tensor),
}

impl Target {
    /// Mean squared latent error of each candidate: `latents` (N, k, h, w, C) to N costs, in normalised units squared.
    /// A cost may be NaN or infinite where the model's latents are.
    ///
    /// # Errors
    /// [`Error::Shape`] where the target has not the shape of the latents.
    pub fn costs(&self, latents: &Tensor) -> crate::Result<Vec<f32>> {
        let (_, steps, height, width, channels) = latents.dims5()?;
        let (target, compared) = match self {
            Self::EachStep(target) => {
                expect(target, &[steps, height, width, channels])?;
                (target, latents.clone())
            }
            Self::LastStep(target) => {
                expect(target, &[height, width, channels])?;
                (
                    target,
                    latents.narrow(1, steps.saturating_sub(1), 1)?.squeeze(1)?,
                )
            }
        };
        let error = compared.broadcast_sub(&target.unsqueeze(0)?)?.sqr()?;
        Ok(error.flatten_from(1)?.mean(D::Minus1)?.to_vec1::<f32>()?)
    }
}

fn expect(target: &Tensor, shape: &[usize]) -> crate::Result<()> {
    if target.dims() == shape {
        return Ok(());
    }
    Err(Error::Shape {
        what: "the planner's target",
        expected: format!("{shape:?}"),
        found: target.dims().to_vec(),
    })
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    #[test]
    fn each_step_counts_all_and_last_step_the_last() {
        let latents =
            Tensor::from_vec(vec![0.0_f32, 2.0, 1.0, 4.0], (2, 2, 1, 1, 1), &Device::Cpu).unwrap();
        let each = Tensor::from_vec(vec![0.0_f32, 1.0], (2, 1, 1, 1), &Device::Cpu).unwrap();
        assert_eq!(Target::EachStep(each).costs(&latents).unwrap(), [0.5, 5.0]);
        let last = Tensor::from_vec(vec![1.0_f32], (1, 1, 1), &Device::Cpu).unwrap();
        assert_eq!(
            Target::LastStep(last.clone()).costs(&latents).unwrap(),
            [1.0, 9.0]
        );
        let message = Target::EachStep(last)
            .costs(&latents)
            .unwrap_err()
            .to_string();
        assert!(message.contains("[2, 1, 1, 1]"), "{message}");
    }
}
