//! The encoder of a model folder: pictures to normalised latents.

use candle_core::{DType, Device, Tensor};
use wm_model::autoencoder::Normalisation;
use wm_model::{Fit, Framing, LatentSpace};

use super::views;
use crate::kinds::encoder::Apply;
use crate::svae::Svae;
use crate::{Error, Result};

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
