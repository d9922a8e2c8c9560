//! The decoder of a model folder: normalised latents to pictures.

use candle_core::{DType, Device, Tensor};
use wm_model::LatentSpace;
use wm_model::autoencoder::Normalisation;

use super::views;
use crate::cost::{self, Cost};
use crate::kinds::{Apply, Kind, apply, parse};
use crate::svae::Svae;
use crate::vae::{
    CosmosConfig, CosmosDecoder, PixelDecoder, PixelDecoderConfig, SdVaeConfig, SdVaeDecoder,
    VaVaeConfig, VaVaeDecoder,
};
use crate::{Loader, Result};

/// The kinds of decoders, each with its configuration.
#[derive(Clone, Debug)]
pub(super) enum DecoderConfig {
    Pixel(PixelDecoderConfig),
    Sd3Vae(SdVaeConfig),
    VaVae(VaVaeConfig),
    Cosmos(CosmosConfig),
}

impl DecoderConfig {
    pub(super) fn parse(kind: Kind, config: &str) -> Result<Self> {
        Ok(match kind {
            Kind::Pixel => Self::Pixel(parse(config)?),
            Kind::Sd3VaeDecoder => Self::Sd3Vae(parse(config)?),
            Kind::VaVaeDecoder => Self::VaVae(parse(config)?),
            Kind::CosmosCi16x16Decoder => Self::Cosmos(parse(config)?),
            other => {
                let reason = format!(
                    "`{other}` is no decoder, expected pixel, sd3-vae-decoder, va-vae-decoder or cosmos-ci16x16-decoder"
                );
                return Err(wm_model::Error::config("kind", reason).into());
            }
        })
    }

    pub(super) fn load(&self, loader: &Loader<'_>) -> Result<Apply> {
        Ok(match self {
            Self::Pixel(config) => apply(PixelDecoder::load(config, loader)?, PixelDecoder::decode),
            Self::Sd3Vae(config) => {
                apply(SdVaeDecoder::load(config, loader)?, SdVaeDecoder::decode)
            }
            Self::VaVae(config) => apply(VaVaeDecoder::load(config, loader)?, VaVaeDecoder::decode),
            Self::Cosmos(config) => {
                apply(CosmosDecoder::load(config, loader)?, CosmosDecoder::decode)
            }
        })
    }

    /// Channels of the latent that it takes.
    pub(super) fn channels(&self) -> usize {
        match self {
            Self::Pixel(config) => config.latent,
            Self::Sd3Vae(config) => config.latent_channels,
            Self::VaVae(config) => config.latent,
            Self::Cosmos(config) => config.latent,
        }
    }

    /// Pixels along the side of one latent place.
    pub(super) fn upsampling(&self) -> Result<usize> {
        match self {
            Self::Pixel(config) => config.upsampling(),
            Self::Sd3Vae(config) => config.downsampling(),
            Self::VaVae(config) => config.downsampling(),
            Self::Cosmos(config) => Ok(config.compression),
        }
    }

    pub(super) fn cost(&self) -> Result<Cost> {
        match self {
            Self::Pixel(config) => cost::pixel_decoder(config),
            Self::Sd3Vae(config) => cost::sd3_decoder(config),
            Self::VaVae(config) => cost::va_vae_decoder(config),
            Self::Cosmos(config) => cost::cosmos_decoder(config),
        }
    }
}

/// Normalisation, adapter and decoder together.
pub(super) struct FolderDecoder {
    pub(super) network: Apply,
    /// Where the network computes.
    pub(super) device: Device,
    /// Through which latents go first.
    pub(super) adapter: Option<Svae>,
    pub(super) normalisation: Normalisation,
    pub(super) upsampling: usize,
    pub(super) views: usize,
    pub(super) space: LatentSpace,
}

impl FolderDecoder {
    fn images(&self, latents: &Tensor) -> Result<Tensor> {
        let (h, w, c) = self.space.shape();
        match latents.dims() {
            &[n, rows, columns, channels] if n > 0 && (rows, columns, channels) == (h, w, c) => {}
            _ => {
                let expected = format!("(N, {h}, {w}, {c})");
                return Err(crate::sizes::shape_error("the latent", expected, latents));
            }
        }
        let mut values = latents
            .to_dtype(DType::F32)?
            .flatten_all()?
            .to_vec1::<f32>()?;
        self.normalisation.undo(&mut values);
        let latents = Tensor::from_vec(values, latents.dims(), &self.device)?;
        let mut latents = views::apart(&latents, self.views)?;
        if let Some(adapter) = &self.adapter {
            latents = adapter.encode(&latents)?;
        }
        let images = views::beside(&(self.network)(&latents)?, self.views)?;
        Ok(images.to_device(&Device::Cpu)?.to_dtype(DType::F32)?)
    }
}

impl wm_model::Decoder for FolderDecoder {
    fn space(&self) -> &LatentSpace {
        &self.space
    }

    fn output_size(&self) -> (usize, usize) {
        (
            self.space.height * self.upsampling,
            self.space.width * self.upsampling,
        )
    }

    fn decode(&self, latents: &Tensor) -> wm_model::Result<Tensor> {
        Ok(self.images(latents)?)
    }
}
