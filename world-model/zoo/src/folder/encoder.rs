//! The encoder of a model folder: pictures to normalised latents.

use candle_core::{DType, Device, Tensor};
use wm_model::autoencoder::Normalisation;
use wm_model::{Fit, Framing, LatentSpace};

use super::views;
use crate::cost::{self, Cost};
use crate::kinds::{Kind, parse};
use crate::sizes::check_multiple;
use crate::svae::Svae;
use crate::vae::{
    CosmosConfig, CosmosEncoder, SdVaeConfig, SdVaeEncoder, VaVaeConfig, VaVaeEncoder,
};
use crate::vit::{SiglipVision, SiglipVisionConfig, Vjepa, VjepaConfig, WebDino, WebDinoConfig};
use crate::{Error, Loader, Result};

/// What a loaded network does with a batch of pictures or latents.
pub(super) type Apply = Box<dyn Fn(&Tensor) -> Result<Tensor> + Send + Sync>;

/// The kinds of encoders, each with its configuration.
#[derive(Clone, Debug)]
pub(super) enum EncoderConfig {
    WebDino(WebDinoConfig),
    Siglip2(SiglipVisionConfig),
    Vjepa21(VjepaConfig),
    Sd3Vae(SdVaeConfig),
    VaVae(VaVaeConfig),
    Cosmos(CosmosConfig),
}

impl EncoderConfig {
    pub(super) fn parse(kind: Kind, config: &str) -> Result<Self> {
        Ok(match kind {
            Kind::WebDino => Self::WebDino(parse(config)?),
            Kind::Siglip2 => Self::Siglip2(parse(config)?),
            Kind::Vjepa21 => Self::Vjepa21(parse(config)?),
            Kind::Sd3Vae => Self::Sd3Vae(parse(config)?),
            Kind::VaVae => Self::VaVae(parse(config)?),
            Kind::CosmosCi16x16 => Self::Cosmos(parse(config)?),
            other => {
                let reason = format!(
                    "`{other}` is no encoder, expected web-dino, siglip2, vjepa2.1, sd3-vae, va-vae or cosmos-ci16x16"
                );
                return Err(wm_model::Error::config("kind", reason).into());
            }
        })
    }

    pub(super) fn load(&self, loader: &Loader<'_>) -> Result<Apply> {
        Ok(match self {
            Self::WebDino(config) => apply(WebDino::load(config, loader)?, WebDino::encode),
            Self::Siglip2(config) => {
                apply(SiglipVision::load(config, loader)?, SiglipVision::encode)
            }
            Self::Vjepa21(config) => apply(Vjepa::load(config, loader)?, Vjepa::encode),
            Self::Sd3Vae(config) => {
                apply(SdVaeEncoder::load(config, loader)?, SdVaeEncoder::encode)
            }
            Self::VaVae(config) => apply(VaVaeEncoder::load(config, loader)?, VaVaeEncoder::encode),
            Self::Cosmos(config) => {
                apply(CosmosEncoder::load(config, loader)?, CosmosEncoder::encode)
            }
        })
    }

    /// Rows, columns and channels that a picture of `image` (height, width) becomes. The configuration has been built.
    pub(super) fn features(&self, [height, width]: [usize; 2]) -> Result<[usize; 3]> {
        let square = |grid: usize, channels| Ok([grid, grid, channels]);
        let downsampled = |step: usize, channels| {
            check_multiple(("image height", height), ("downsampling", step))?;
            check_multiple(("image width", width), ("downsampling", step))?;
            Ok([height / step, width / step, channels])
        };
        match self {
            Self::WebDino(config) => square(config.grid(), config.hidden_size),
            Self::Siglip2(config) => square(config.grid(), config.hidden_size),
            Self::Vjepa21(config) => square(config.grid(), config.hidden),
            Self::Sd3Vae(config) => downsampled(config.downsampling()?, config.latent_channels),
            Self::VaVae(config) => downsampled(config.downsampling()?, config.latent),
            Self::Cosmos(config) => downsampled(config.compression, config.latent),
        }
    }

    /// Every value of the configuration, defaults included, as text.
    pub(super) fn canonical(&self) -> Result<String> {
        match self {
            Self::WebDino(config) => canonical(config),
            Self::Siglip2(config) => canonical(config),
            Self::Vjepa21(config) => canonical(config),
            Self::Sd3Vae(config) => canonical(config),
            Self::VaVae(config) => canonical(config),
            Self::Cosmos(config) => canonical(config),
        }
    }

    pub(super) fn cost(&self) -> Result<Cost> {
        match self {
            Self::WebDino(config) => cost::web_dino(config),
            Self::Siglip2(config) => cost::siglip2(config),
            Self::Vjepa21(config) => cost::vjepa(config),
            Self::Sd3Vae(config) => cost::sd3_encoder(config),
            Self::VaVae(config) => cost::va_vae_encoder(config),
            Self::Cosmos(config) => cost::cosmos_encoder(config),
        }
    }
}

/// A configuration as text, in the order of its fields: what hashes are over.
pub(super) fn canonical(config: &impl serde::Serialize) -> Result<String> {
    serde_json::to_string(config).map_err(|error| Error::ConfigFile {
        file: "the configuration".to_owned(),
        reason: error.to_string(),
    })
}

pub(super) fn apply<M: Send + Sync + 'static>(
    model: M,
    run: fn(&M, &Tensor) -> Result<Tensor>,
) -> Apply {
    Box::new(move |input| run(&model, input))
}

/// Encoder, adapter and normalisation together.
pub(super) struct FolderEncoder {
    pub(super) network: Apply,
    /// Where the network computes.
    pub(super) device: Device,
    pub(super) adapter: Option<Svae>,
    pub(super) normalisation: Normalisation,
    /// Height and width of one view's picture.
    pub(super) image: [usize; 2],
    pub(super) views: usize,
    pub(super) fit: Fit,
    pub(super) space: LatentSpace,
}

impl FolderEncoder {
    fn latents(&self, images: &Tensor) -> Result<Tensor> {
        let (height, width) = wm_model::Encoder::input_size(self);
        match images.dims() {
            &[n, h, w, 3] if n > 0 && (h, w) == (height, width) => {}
            _ => {
                let expected = format!("(N, {height}, {width}, 3)");
                return Err(crate::sizes::shape_error("the image", expected, images));
            }
        }
        let images = images.to_device(&self.device)?;
        let mut latents = (self.network)(&views::apart(&images, self.views)?)?;
        if let Some(adapter) = &self.adapter {
            latents = adapter.encode(&latents)?;
        }
        let latents = views::beside(&latents, self.views)?;
        let (h, w, c) = self.space.shape();
        let mut values = latents
            .to_dtype(DType::F32)?
            .flatten_all()?
            .to_vec1::<f32>()?;
        self.normalisation.apply(&mut values);
        if values.iter().any(|v| !v.is_finite()) {
            return Err(Error::Model(wm_model::Error::NotFinite {
                what: "the latent",
            }));
        }
        Ok(Tensor::from_vec(values, ((), h, w, c), &Device::Cpu)?)
    }
}

impl wm_model::Encoder for FolderEncoder {
    fn space(&self) -> &LatentSpace {
        &self.space
    }

    fn input_size(&self) -> (usize, usize) {
        let [height, width] = self.image;
        (height, width * self.views)
    }

    fn framing(&self) -> Framing {
        Framing {
            size: wm_model::Encoder::input_size(self),
            views: self.views,
            fit: self.fit,
        }
    }

    fn encode(&self, images: &Tensor) -> wm_model::Result<Tensor> {
        Ok(self.latents(images)?)
    }
}
