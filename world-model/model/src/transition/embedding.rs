//! From latents, noise levels and actions to tokens and conditioning.

use candle_core::{D, Device, Tensor};

use super::TransitionConfig;
use super::condition::{Condition, ConditionEmbedding, frequencies};
use super::parameters::{FREQUENCIES, Tensors};
use crate::Result;
use crate::ops::token_layers::{Linear, TensorLayers, TokenLayers as _};

/// Patch embedding, time embedding and action embedding.
#[derive(Clone, Debug)]
pub(super) struct Embedding {
    /// (d, C, p, p), as a convolution's.
    pub(super) patch_weight: Tensor,
    patch_bias: Tensor,
    condition: ConditionEmbedding<Linear>,
    /// (1, FREQUENCIES).
    frequencies: Tensor,
}

impl Embedding {
    pub(super) fn new(tensors: &mut Tensors) -> Result<Self> {
        let patch_weight = tensors.take("x_proj.weight")?;
        let shape = (1, FREQUENCIES);
        Ok(Self {
            frequencies: Tensor::from_vec(frequencies(), shape, patch_weight.device())?,
            patch_weight,
            patch_bias: tensors.take("x_proj.bias")?,
            condition: ConditionEmbedding::new(tensors)?,
        })
    }

    /// Where the parameters are.
    pub(super) fn device(&self) -> &Device {
        self.patch_weight.device()
    }

    /// Patches (.., p * p * C) to tokens (.., d).
    pub(super) fn tokens(&self, layers: &mut TensorLayers, patches: &Tensor) -> Result<Tensor> {
        // The patches' values are in the order row, column, channel.
        let weight = self.patch_weight.permute((0, 2, 3, 1))?.flatten_from(1)?;
        let linear = Linear {
            weight: weight.contiguous()?,
            bias: Some(self.patch_bias.clone()),
        };
        layers.linear(&linear, patches)
    }

    /// `tau` (frames) and `action` (frames, A).
    pub(super) fn condition(
        &self,
        layers: &mut TensorLayers,
        tau: &Tensor,
        action: &Tensor,
    ) -> Result<Condition<Tensor>> {
        let angles = tau.unsqueeze(1)?.broadcast_mul(&self.frequencies)?;
        let waves = Tensor::cat(&[angles.cos()?, angles.sin()?], D::Minus1)?;
        self.condition.at(layers, &waves, action)
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
