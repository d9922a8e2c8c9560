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
mod loaded;
mod published;
mod rollout;

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use candle_core::{Device, Tensor};
use serde::de::DeserializeOwned;
use wm_model::Compute;

pub use dit::{DitConfig, Head};
pub(crate) use dit::{build as build_dit, build_transition, load_transition};
pub(crate) use encoder::{Apply, Canonical, EncoderConfig, apply};
pub use loaded::Loaded;
pub use rollout::{RolloutOptions, rollout};

use crate::checkpoint::Average;
use crate::vae::{CosmosConfig, SdVaeConfig, VaVaeConfig};
use crate::vit::{SiglipVisionConfig, VjepaConfig, WebDinoConfig};
use crate::{Checkpoint, Error, Result};
use inputs::is_finite;

/// Tensors by name.
pub type Tensors = BTreeMap<String, Tensor>;

/// Defines [`Kind`]. A line has a kind, its name on the command line and, if it is an encoder, its
/// [`EncoderConfig`](encoder::EncoderConfig).
macro_rules! kinds {
    ($($kind:ident = $name:literal $(, encoder $config:ty)?;)*) => {
        /// A kind of model, as the command line names it; the [module](self) says what each takes and gives.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        #[expect(missing_docs, reason = "the module has a table of them")]
        pub enum Kind {
            $($kind,)*
        }

        impl Kind {
            /// All kinds.
            pub const ALL: &'static [Self] = &[$(Self::$kind,)*];

            /// Its name on the command line.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name,)*
                }
            }

            fn encoder_parser(self) -> Option<encoder::EncoderParser> {
                match self {
                    $($(Self::$kind => Some(encoder::parser::<$config>),)?)*
                    _ => None,
                }
            }
        }
    };
}

kinds! {
    Dit = "dit";
    WebDino = "web-dino", encoder WebDinoConfig;
    Siglip2 = "siglip2", encoder SiglipVisionConfig;
    Siglip2Text = "siglip2-text";
    Vjepa21 = "vjepa2.1", encoder VjepaConfig;
    Sd3Vae = "sd3-vae", encoder SdVaeConfig;
    Sd3VaeDecoder = "sd3-vae-decoder";
    VaVae = "va-vae", encoder VaVaeConfig;
    VaVaeDecoder = "va-vae-decoder";
    CosmosCi16x16 = "cosmos-ci16x16", encoder CosmosConfig;
    CosmosCi16x16Decoder = "cosmos-ci16x16-decoder";
    Svae = "svae";
    Pixel = "pixel";
    Idm = "idm";
    SuccessProbe = "success-probe";
    LinearProbe = "linear-probe";
    TemporalProbe = "temporal-probe";
    ProgressProbe = "progress-probe";
    EfficientNetLite0 = "efficientnet-lite0";
}

impl Kind {
    /// The tensors of this kind of model in `checkpoint`, without what its authors wrapped around them.
    pub fn weights(self, checkpoint: &Checkpoint, average: Average) -> Checkpoint {
        // Whose checkpoint holds several networks, each under its own name.
        let parts: &[&str] = match (self, average) {
            (Self::Vjepa21, Average::Ema) => &["ema_encoder", "target_encoder", "encoder"],
            (Self::Vjepa21, Average::Raw) => &["encoder"],
            (Self::Svae, _) => &["adapter"],
            (Self::Pixel, _) => &["pixel_decoder"],
            _ => &[],
        };
        checkpoint
            .weights(average)
            .first_part(parts)
            .weights(average)
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Kind {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let found = Self::ALL.iter().find(|kind| kind.name() == name);
        found.copied().ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|kind| kind.name()).collect();
            let names = names.join(", ");
            wm_model::Error::config("kind", format!("`{name}`, expected one of {names}")).into()
        })
    }
}

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

/// A configuration from JSON.
pub(crate) fn parse<C: DeserializeOwned>(config: &str) -> Result<C> {
    serde_json::from_str(config).map_err(|error| Error::ConfigFile {
        file: "the configuration".to_owned(),
        reason: error.to_string(),
    })
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
