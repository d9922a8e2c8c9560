//! Rollouts of plain values, for callers without tensors.

use candle_core::{Device, Tensor};

use super::{Given, Noise, Rollout, Sampler};
use crate::transition::LoadedTransition;
use crate::{Error, Result};

/// What was observed and done before a prediction, and the noise of the prediction.
#[derive(Clone, Debug)]
pub struct Observed<'a> {
    /// Latents, oldest first, at least one; each row-major, channels last.
    pub frames: Vec<&'a [f32]>,
    /// Model actions: number i leads from frame i to the next.
    pub actions: Vec<&'a [f32]>,
    /// The noise.
    pub noise: Noise,
}

impl<'m> Rollout<'m> {
    /// As [`Rollout::batch`], from plain values: one rollout for each of `rows`, which have equally many frames.
    ///
    /// # Errors
    /// If a frame or an action has another length than the model's, a row another number of them, or a value is not
    /// finite.
    pub fn of_values(
        model: &'m LoadedTransition,
        sampler: &Sampler,
        rows: &[Observed<'_>],
    ) -> Result<Self> {
        let config = model.config();
        let grid = [config.latent_height, config.latent_width, config.channels];
        let frames = rows.iter().map(|row| row.frames.as_slice());
        let context = each("the context", frames, &grid)?;
        let between = match context.dim(1)? {
            1 => None,
            _ => {
                let actions = rows.iter().map(|row| row.actions.as_slice());
                Some(each("the actions", actions, &[config.action_dim])?)
            }
        };
        let noise: Vec<Noise> = rows.iter().map(|row| row.noise).collect();
        Self::batch(model, sampler, &context, between.as_ref(), &noise)
    }

    /// As [`Rollout::next_given`], from plain values: where each candidate's action leads, if its action of `own` leads on
    /// from there; without `own` the rule of [`Given::own_action`] applies.
    ///
    /// # Errors
    /// As there.
    pub fn predict(&mut self, actions: &[&[f32]], own: Option<&[&[f32]]>) -> Result<Vec<Vec<f32>>> {
        let shape = [self.action_dim()];
        let action = stacked("the action", actions, &shape)?;
        let own = own.map(|own| stacked("the new frame's own action", own, &shape));
        let own = own.transpose()?;
        let given = Given {
            own_action: own.as_ref(),
            ..Given::default()
        };
        let latents = self.next_given(&action, given)?;
        Ok(latents.flatten_from(1)?.to_vec2::<f32>()?)
    }
}

/// Values of `shape` each as one tensor (n, shape..) on the CPU.
pub(crate) fn stacked(what: &'static str, rows: &[&[f32]], shape: &[usize]) -> Result<Tensor> {
    let len: usize = shape.iter().product();
    if let Some(wrong) = rows.iter().find(|row| row.len() != len) {
        return Err(Error::Shape {
            what,
            expected: format!("{len} values"),
            found: vec![wrong.len()],
        });
    }
    let shape = [&[rows.len()], shape].concat();
    Ok(Tensor::from_vec(rows.concat(), shape, &Device::Cpu)?)
}

/// Equally many values of `shape` in each row as one tensor (rows, n, shape..) on the CPU.
fn each<'a>(
    what: &'static str,
    rows: impl Iterator<Item = &'a [&'a [f32]]>,
    shape: &[usize],
) -> Result<Tensor> {
    let rows = rows.map(|row| stacked(what, row, shape));
    let rows = rows.collect::<Result<Vec<_>>>()?;
    if let [first, rest @ ..] = rows.as_slice()
        && let Some(wrong) = rest.iter().find(|row| row.dims() != first.dims())
    {
        return Err(Error::Shape {
            what,
            expected: format!("{:?} in every row", first.dims()),
            found: wrong.dims().to_vec(),
        });
    }
    Ok(Tensor::stack(&rows, 0)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transition::{Transition, TransitionConfig};

    fn values(len: usize, first: usize) -> Vec<f32> {
        (first..first + len)
            .map(|i| (i as f32 * 0.37).sin())
            .collect()
    }

    #[test]
    fn plain_values_predict_as_tensors_do() {
        let config = TransitionConfig::preset("tiny", (4, 4, 4), 2, 7).unwrap();
        let model = Transition::random(config, 1).unwrap().pack().unwrap();
        let sampler = &model.config().sampler;
        let frames = [values(64, 0), values(64, 64)];
        let actions = [values(7, 1), values(7, 2), values(7, 3)];
        let noise = Noise {
            seed: 5,
            first_step: 0,
        };
        let observed = Observed {
            frames: frames.iter().map(Vec::as_slice).collect(),
            actions: vec![&actions[0]],
            noise,
        };
        let row = |values: &[f32]| Tensor::from_slice(values, (1, 7), &Device::Cpu).unwrap();
        let context = Tensor::from_vec(frames.concat(), (1, 2, 4, 4, 4), &Device::Cpu).unwrap();
        let between = row(&actions[0]);
        let mut tensors = Rollout::new(&model, sampler, &context, Some(&between), 5).unwrap();
        let own = row(&actions[2]);
        let given = Given {
            own_action: Some(&own),
            ..Given::default()
        };
        let expected = tensors.next_given(&row(&actions[1]), given).unwrap();
        let expected: Vec<f32> = expected.flatten_all().unwrap().to_vec1().unwrap();

        let mut rollout =
            Rollout::of_values(&model, sampler, std::slice::from_ref(&observed)).unwrap();
        let found = rollout.predict(&[&actions[1]], Some(&[&actions[2]]));
        assert_eq!(found.unwrap(), [expected]);

        let short = Observed {
            frames: vec![&frames[0][1..]],
            ..observed.clone()
        };
        let error = Rollout::of_values(&model, sampler, &[short]).unwrap_err();
        assert!(error.to_string().contains("expected 64 values"), "{error}");
        let fewer = Observed {
            frames: vec![&frames[0]],
            ..observed.clone()
        };
        let error = Rollout::of_values(&model, sampler, &[observed, fewer]).unwrap_err();
        assert!(error.to_string().contains("in every row"), "{error}");
        let error = rollout.predict(&[&actions[1][1..]], None).unwrap_err();
        assert!(error.to_string().contains("expected 7 values"), "{error}");
        assert!(Rollout::of_values(&model, sampler, &[]).is_err());
    }
}
