//! From latents, noise levels and actions to tokens and conditioning.

use candle_core::{D, Device, Tensor};

use super::TransitionConfig;
use super::parameters::{FREQUENCIES, Linear, Tensors};
use crate::Result;
use crate::ops::{self, Engine};

/// Ratio of the highest frequency to that which follows the lowest.
const FREQUENCY_RANGE: f64 = 10_000.0;

/// tau in 0..1 is stretched to this range before the sinusoid.
const TAU_SCALE: f64 = 1_000.0;

/// What modulates the layers, per frame; rows are the frames of the batch, (B * T, d).
#[derive(Clone, Debug)]
pub(super) struct Condition {
    /// Time embedding alone.
    pub(super) time: Tensor,
    /// SiLU of time plus action embedding, which is what every modulation starts from.
    pub(super) activated: Tensor,
}

impl Condition {
    /// That of the `last` frames of `b` clips of `t` frames.
    pub(super) fn of_last(&self, last: usize, (b, t): (usize, usize)) -> Result<Self> {
        if last == t {
            return Ok(self.clone());
        }
        let narrow = |rows: &Tensor| -> Result<Tensor> {
            let frames = rows.reshape((b, t, ()))?.narrow(1, t - last, last)?;
            Ok(frames.flatten_to(1)?)
        };
        Ok(Self {
            time: narrow(&self.time)?,
            activated: narrow(&self.activated)?,
        })
    }
}

/// Patch embedding, time embedding and action embedding.
#[derive(Clone, Debug)]
pub(super) struct Embedding {
    /// (d, C, p, p), as a convolution's.
    pub(super) patch_weight: Tensor,
    pub(super) patch_bias: Tensor,
    pub(super) time: [Linear; 2],
    pub(super) action: Linear,
    /// (1, FREQUENCIES).
    pub(super) frequencies: Tensor,
}

/// Radians of each wave at noise level 1.
pub(super) fn frequencies() -> Vec<f32> {
    (0..FREQUENCIES)
        .map(|i| {
            let exponent = -FREQUENCY_RANGE.ln() * i as f64 / FREQUENCIES as f64;
            (exponent.exp() * TAU_SCALE) as f32
        })
        .collect()
}

impl Embedding {
    pub(super) fn new(tensors: &mut Tensors) -> Result<Self> {
        let patch_weight = tensors.take("x_proj.weight")?;
        let shape = (1, FREQUENCIES);
        Ok(Self {
            frequencies: Tensor::from_vec(frequencies(), shape, patch_weight.device())?,
            patch_weight,
            patch_bias: tensors.take("x_proj.bias")?,
            time: [
                tensors.linear("timestep_mlp.0")?,
                tensors.linear("timestep_mlp.2")?,
            ],
            action: tensors.linear("action_embedder")?,
        })
    }

    /// Where the parameters are.
    pub(super) fn device(&self) -> &Device {
        self.patch_weight.device()
    }

    /// Patches (.., p * p * C) to tokens (.., d).
    pub(super) fn tokens(&self, engine: Engine, patches: &Tensor) -> Result<Tensor> {
        // The patches' values are in the order row, column, channel.
        let weight = self.patch_weight.permute((0, 2, 3, 1))?.flatten_from(1)?;
        Ok(ops::linear(
            engine,
            patches,
            &weight.contiguous()?,
            Some(&self.patch_bias),
        )?)
    }

    /// `tau` (frames) and `action` (frames, A).
    pub(super) fn condition(
        &self,
        engine: Engine,
        tau: &Tensor,
        action: &Tensor,
    ) -> Result<Condition> {
        let angles = tau.unsqueeze(1)?.broadcast_mul(&self.frequencies)?;
        let waves = Tensor::cat(&[angles.cos()?, angles.sin()?], D::Minus1)?;
        let [first, second] = &self.time;
        let hidden = first.forward(engine, &waves)?;
        let time = second.forward(engine, &hidden.silu()?)?;
        let action = self.action.forward(engine, action)?;
        let activated = (&time + action)?.silu()?;
        Ok(Condition { time, activated })
    }
}

/// Between latents and patches.
pub(super) struct Patches;

impl Patches {
    /// (B, T, H, W, C) to (B, T, N, p * p * C), values in the order row, column, channel.
    pub(super) fn of(x: &Tensor, patch: usize) -> Result<Tensor> {
        let (b, t, h, w, c) = x.dims5()?;
        let grid = x
            .reshape((b * t * (h / patch), patch, w / patch, patch * c))?
            .transpose(1, 2)?
            .contiguous()?;
        let tokens = (h / patch) * (w / patch);
        Ok(grid.reshape((b, t, tokens, patch * patch * c))?)
    }

    /// The inverse of [`Patches::of`], for (B, T, N, p * p * C).
    pub(super) fn into_grid(
        patches: &Tensor,
        (b, t): (usize, usize),
        config: &TransitionConfig,
    ) -> Result<Tensor> {
        let (p, c) = (config.patch, config.channels);
        let (rows, columns) = config.grid();
        let grid = patches
            .reshape((b * t * rows, columns, p, p * c))?
            .transpose(1, 2)?
            .contiguous()?;
        Ok(grid.reshape((b, t, config.latent_height, config.latent_width, c))?)
    }
}
