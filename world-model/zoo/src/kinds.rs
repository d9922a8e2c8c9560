//! Any of the models on tensors by name: what `wm model forward` and `wm model rollout` do.
//!
//! | kind | config (JSON) | input | output |
//! |---|---|---|---|
//! | `dit` | [`DitConfig`] | `x` (B,T,H,W,C), `tau` (B,T) in 0..1, `action` (B,T,A) | `velocity` (B,T,H,W,C) |
//! | `web-dino` | Hugging Face's config.json (Dinov2) | `image` | `latent` |
//! | `siglip2` | Hugging Face's config.json (Siglip) | `image` | `latent` |
//! | `siglip2-text` | Hugging Face's config.json (Siglip) | `input_ids` (B,L), maybe `text_mask` (B,L) | `features` (B,L,D) |
//! | `vjepa2.1` | `VjepaConfig` (`vit/vjepa.rs`) | `image` | `latent` |
//! | `sd3-vae`, `sd3-vae-decoder` | diffusers' config.json (AutoencoderKL) | `image` or `latent` | `latent` or `image` |
//! | `va-vae`, `va-vae-decoder` | `VaVaeConfig` (`vae/va_vae.rs`) | the same | the same |
//! | `cosmos-ci16x16`, `cosmos-ci16x16-decoder` | `CosmosConfig` (`vae/cosmos.rs`) | the same | the same |
//! | `svae` | [`SvaeConfig`](crate::SvaeConfig) | `features` (N,h,w,D), or `latent` to decode | `latent` (N,h,w,d), `features` |
//! | `pixel` | [`PixelDecoderConfig`](crate::PixelDecoderConfig) | `latent` | `image` |
//! | `idm` | [`IdmConfig`](crate::idm::IdmConfig) | `latents` (B,k+1,h,w,D) | `actions` (B,k,7) |
//! | `success-probe` | [`SuccessProbeConfig`](crate::success_probe::SuccessProbeConfig) | `latents` (B,T,h,w,D), `text` (B,L,D'), maybe `text_mask` (B,L) | `logit` (B) |
//! | `linear-probe`, `temporal-probe` | [`LinearProbeConfig`](crate::pooled_probe::LinearProbeConfig), [`TemporalProbeConfig`](crate::pooled_probe::TemporalProbeConfig) | `latents` (B,T,h,w,D) | `logit` (B) |
//! | `progress-probe` | [`ProgressProbeConfig`](crate::pooled_probe::ProgressProbeConfig) | `latents` (B,T,h,w,D) | `progress` (B,T) |
//! | `efficientnet-lite0` | `EfficientNetLite0Config` (`efficientnet_lite0.rs`) | `image` | `block_8` up to the configured block |
//!
//! An `image` is (N,H,W,3) in 0..1, a `latent` (N,h,w,D). Everything is f32 but `input_ids`, which are integers.

pub(crate) mod dit;
pub(crate) mod encoder;
mod inputs;
pub(crate) mod kind;
mod loaded;
pub(crate) mod parse;
mod published;
mod rollout;

use std::collections::BTreeMap;

use candle_core::{Device, Tensor};
use wm_model::Compute;

pub use dit::{DitConfig, Head};
pub(crate) use dit::{build as build_dit, build_transition, load_transition};
pub(crate) use encoder::{Apply, Canonical, EncoderConfig, apply};
pub use kind::Kind;
pub use loaded::Loaded;
pub(crate) use parse::parse;
pub use rollout::{RolloutOptions, rollout};

use crate::{Checkpoint, Result};
use inputs::is_finite;

/// Tensors by name.
pub type Tensors = BTreeMap<String, Tensor>;

/// Runs a model of `kind` with the configuration `config` (JSON) and the weights of `checkpoint` (the averaged ones,
/// if it has both) on `inputs`. Weights and inputs go to the device of `compute`; outputs are on the CPU.
///
/// # Errors
/// As [`Loaded::new`] and [`Loaded::run`].
pub fn forward(
    kind: Kind,
    config: &str,
    checkpoint: &Checkpoint,
    inputs: &Tensors,
    compute: &Compute,
) -> Result<Tensors> {
    Loaded::new(kind, config, checkpoint, compute)?.run(inputs)
}

fn owned(outputs: Vec<(&str, Tensor)>) -> Tensors {
    outputs
        .into_iter()
        .map(|(name, tensor)| (name.to_owned(), tensor))
        .collect()
}

/// Passes outputs on whose values are all finite, and brings them to the CPU. Weights that do not belong together, or an epsilon that does not fit
/// them, can lead beyond what f32 holds.
fn finite(outputs: Tensors) -> Result<Tensors> {
    outputs
        .into_iter()
        .map(|(name, tensor)| {
            let tensor = tensor.to_device(&Device::Cpu)?;
            if !is_finite(&tensor)? {
                let reason = format!("`{name}` comes out with a value that is not finite");
                return Err(wm_model::Error::config("output", reason).into());
            }
            Ok((name, tensor))
        })
        .collect()
}

#[cfg(test)]
mod tests;
