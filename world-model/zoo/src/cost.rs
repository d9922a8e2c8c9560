//! Parameters and operations of the paper's systems, counted from the models as they are built.
//!
//! A model is built without weights, and what it asks of a checkpoint is counted. The operations of a layer are twice
//! the values of its weight for every place that it is applied at (a multiplication and an addition), and for
//! attention the products of queries with keys and of weights with values; norms, activations and additions are not
//! counted. Conventions of the paper's table
//! "Architecture size and compute" (appendix B):
//!
//! - everything for one 256x256 frame; of the DiT one velocity evaluation of a clip of 10 frames, divided by 10,
//!   without patch and action embedding;
//! - of the adapter the parameters of both halves, the operations of the encoder;
//! - no attention products in the vision transformers and in SD3's autoencoder; in all others they are counted;
//! - V-JEPA's and SigLIP's patch embedding is not counted, Web-DINO's is, and so is SigLIP's pooling head.

mod adapter;
mod autoencoder;
pub(crate) mod count;
mod probe;
mod transition;
mod vit;

use serde::Serialize;

use crate::svae::SvaeConfig;
use crate::vae::{CosmosConfig, PixelDecoderConfig, SdVaeConfig, VaVaeConfig};
use crate::vit::{SiglipVisionConfig, VjepaConfig, WebDinoConfig};
use crate::{Error, Result};

pub(crate) use adapter::adapter;
pub(crate) use autoencoder::{
    cosmos_decoder, cosmos_encoder, pixel_decoder, sd3_decoder, sd3_encoder, va_vae_decoder,
    va_vae_encoder,
};
pub use count::Cost;
pub(crate) use count::{applied, attended, count};
pub(crate) use probe::{pooled_probe, siglip2_text, success_probe};
pub(crate) use transition::transition;
pub use transition::{CLIP_FRAMES, transition_of};
pub(crate) use vit::{siglip2, vjepa, web_dino};

/// Side of the frames that costs are counted for, in pixels.
pub(crate) const FRAME_SIDE: usize = 256;

/// Number of an action's values in the published models.
const ACTIONS: usize = 10;

/// One of the paper's systems with DiT-L.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Its name, as in paper_arch_table.json.
    pub name: &'static str,
    /// Frames to features.
    pub encoder: Cost,
    /// Features to a compact latent and back, if there is one.
    pub adapter: Option<Cost>,
    /// The transition model.
    pub dit: Cost,
    /// Latents to frames.
    pub decoder: Cost,
}

/// A [`Row`] in millions of parameters and thousands of millions of operations, rounded to a thousandth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the names are those of the paper's table")]
pub struct Figures {
    pub enc_params_m: f64,
    pub adapter_params_m: Option<f64>,
    pub dit_params_m: f64,
    pub dec_params_m: f64,
    pub enc_gflops: f64,
    pub adapter_gflops: Option<f64>,
    pub dit_gflops: f64,
    pub dec_gflops: f64,
    pub total_gflops: f64,
}

impl Row {
    /// Names of all rows, in the order of the paper's table.
    pub const NAMES: [&'static str; 9] = [
        "sd3-vae",
        "cosmos-ci16x16",
        "va-vae",
        "vjepa2.1-96",
        "vjepa2.1",
        "web-dino-96",
        "web-dino",
        "siglip2-96",
        "siglip2",
    ];

    /// Builds the models of the system `name` and counts.
    ///
    /// # Errors
    /// If there is no system of that name.
    pub fn count(name: &str) -> Result<Self> {
        let semantic = |name, encoder: Cost, features: usize| -> Result<Self> {
            Ok(Self {
                name,
                encoder,
                adapter: None,
                dit: transition::large((16, 16, features), 1, true)?,
                decoder: pixel_decoder(&PixelDecoderConfig::paper())?,
            })
        };
        let adapted = |name, encoder: Cost, features: usize| -> Result<Self> {
            let svae = SvaeConfig::paper(features);
            Ok(Self {
                name,
                encoder,
                adapter: Some(adapter(&svae)?),
                dit: transition::large((16, 16, svae.latent), 1, false)?,
                decoder: pixel_decoder(&PixelDecoderConfig::paper())?,
            })
        };
        let vjepa = || vit::vjepa(&VjepaConfig::vit_large());
        let web_dino = || vit::web_dino(&WebDinoConfig::vit_large());
        let siglip2 = || vit::siglip2(&SiglipVisionConfig::so400m());
        let row = match name {
            "sd3-vae" => Self {
                name: "sd3-vae",
                encoder: sd3_encoder(&SdVaeConfig::sd3())?,
                adapter: None,
                dit: transition::large((32, 32, 16), 2, false)?,
                decoder: sd3_decoder(&SdVaeConfig::sd3())?,
            },
            "cosmos-ci16x16" => Self {
                name: "cosmos-ci16x16",
                encoder: cosmos_encoder(&CosmosConfig::ci16x16())?,
                adapter: None,
                dit: transition::large((16, 16, 16), 1, false)?,
                decoder: cosmos_decoder(&CosmosConfig::ci16x16())?,
            },
            "va-vae" => Self {
                name: "va-vae",
                encoder: va_vae_encoder(&VaVaeConfig::f16d32())?,
                adapter: None,
                dit: transition::large((16, 16, 32), 1, false)?,
                decoder: va_vae_decoder(&VaVaeConfig::f16d32())?,
            },
            "vjepa2.1-96" => adapted("vjepa2.1-96", vjepa()?, 1024)?,
            "vjepa2.1" => semantic("vjepa2.1", vjepa()?, 1024)?,
            "web-dino-96" => adapted("web-dino-96", web_dino()?, 1024)?,
            "web-dino" => semantic("web-dino", web_dino()?, 1024)?,
            "siglip2-96" => adapted("siglip2-96", siglip2()?, 1152)?,
            "siglip2" => semantic("siglip2", siglip2()?, 1152)?,
            _ => {
                let names = Self::NAMES.join(", ");
                let reason = format!("`{name}`, expected one of {names}");
                return Err(Error::Model(wm_model::Error::config("name", reason)));
            }
        };
        Ok(row)
    }

    /// Operations for one frame of all parts together.
    pub fn operations(&self) -> usize {
        // A model without an adapter computes nothing there.
        let adapter = self.adapter.unwrap_or_default();
        let parts = [self.encoder, adapter, self.dit, self.decoder];
        parts.iter().map(|part| part.operations).sum()
    }

    /// The figures of the paper's table.
    pub fn figures(&self) -> Figures {
        let round = |value: f64| (value * 1e3).round() / 1e3;
        Figures {
            enc_params_m: round(self.encoder.millions()),
            adapter_params_m: self.adapter.map(|cost| round(cost.millions())),
            dit_params_m: round(self.dit.millions()),
            dec_params_m: round(self.decoder.millions()),
            enc_gflops: round(self.encoder.gflops()),
            adapter_gflops: self.adapter.map(|cost| round(cost.gflops())),
            dit_gflops: round(self.dit.gflops()),
            dec_gflops: round(self.decoder.gflops()),
            total_gflops: round(self.operations() as f64 / 1e9),
        }
    }
}

#[cfg(test)]
mod tests;
