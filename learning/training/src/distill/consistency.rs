//! Causal consistency distillation, all frames of a clip at once; see the equations in [`super`].

use anyhow::Result;
use candle_core::{D, Tensor};
use rand_chacha::ChaCha8Rng;
use wm_model::transition::Transition;

use super::{Networks, levels::Levels};
use crate::transition::Batch;

/// Noisy frames, and the teacher's step from them.
pub(super) struct Steps {
    batch: Batch,
    /// Given frames at the start of a clip.
    past: usize,
    /// The noisy frames (B, n - H, h, w, C).
    x: Tensor,
    /// Their levels, and those of the student's results: (B, n - H).
    from: Tensor,
    end: Tensor,
    /// Targets of the student.
    target: Tensor,
}

impl Steps {
    /// One teacher step for each frame of `batch`, between random levels.
    pub(super) fn draw(
        networks: &Networks<'_>,
        batch: Batch,
        past: usize,
        levels: &Levels,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self> {
        let (b, later) = (batch.target.dim(0)?, batch.target.dim(1)?);
        let rungs = (0..b * later).map(|_| levels.draw(rng));
        let rungs = rungs.collect::<Result<Vec<_>>>()?;
        let tensor = |values: Vec<f32>| Tensor::from_vec(values, (b, later), batch.target.device());
        let from = tensor(rungs.iter().map(|rung| rung.from as f32).collect())?;
        let to = tensor(rungs.iter().map(|rung| rung.to as f32).collect())?;
        let end = tensor(rungs.iter().map(|rung| rung.end as f32).collect())?;
        let is_last = tensor(rungs.iter().map(|rung| f32::from(rung.to == 0.0)).collect())?;

        let x = batch.noised(&from)?;
        let stepped = moved(networks.teacher, &batch, past, &x, &from, &to)?;
        let led = moved(networks.target, &batch, past, &stepped, &to, &end)?.detach();
        let is_last = is_last.reshape((b, later, 1, 1, 1))?;
        let real = batch.target.broadcast_mul(&is_last)?;
        let target = (real + led.broadcast_mul(&(1.0 - is_last)?)?)?;
        Ok(Self {
            batch,
            past,
            x,
            from,
            end,
            target,
        })
    }

    /// Distance of the student to the targets.
    pub(super) fn loss(&self, student: &Transition, huber: f64) -> Result<Tensor> {
        let (batch, past, x) = (&self.batch, self.past, &self.x);
        let found = moved(student, batch, past, x, &self.from, &self.end)?;
        pseudo_huber(&(found - &self.target)?, huber)
    }
}

/// sqrt(d^2 + c^2) - c with the root mean square d over a frame of `errors` (B, n, h, w, C), averaged over frames: squared
/// for d far below c, linear elsewhere.
pub(super) fn pseudo_huber(errors: &Tensor, c: f64) -> Result<Tensor> {
    let square = errors.sqr()?.flatten_from(2)?.mean(D::Minus1)?;
    Ok(((square + c * c)?.sqrt()? - c)?.mean_all()?)
}

/// End of the straight line along `model`'s velocity from `x`, from its noise levels to lower ones, both (B, n - H).
fn moved(
    model: &Transition,
    batch: &Batch,
    past: usize,
    x: &Tensor,
    from: &Tensor,
    to: &Tensor,
) -> Result<Tensor> {
    let config = model.config();
    let history = &batch.history;
    let context_tau = config.sampler.context_tau;
    let output = batch.output_at(model, history, (x, from), context_tau, past)?;
    let previous = batch.previous(history, past)?;
    let velocity = config
        .parametrisation
        .velocity(&output, x, from, &previous)?;
    let (b, later) = from.dims2()?;
    let length = (from - to)?.reshape((b, later, 1, 1, 1))?;
    Ok((x - velocity.broadcast_mul(&length)?)?)
}
