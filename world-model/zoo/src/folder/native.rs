//! From an adapter's latents back to the features of its encoder.

use candle_core::{DType, Device, Tensor};
use sha2::{Digest as _, Sha256};
use wm_model::autoencoder::Normalisation;
use wm_model::{Compute, LatentSpace, NumberFormat};

use super::source::{KnownInputs, Source};
use super::{DescribedFolder, Opened, load_adapter, views};
use crate::kinds::encoder::Canonical;
use crate::sizes::shape_error;
use crate::svae::{Svae, SvaeConfig};
use crate::{Error, Result};

/// The adapter's decoder: what was trained on the features of an encoder, its native latent space, can read the latents
/// of its adapter through it (the paper, appendix C.3).
#[derive(Clone, Debug)]
pub struct NativeDecoder {
    adapter: Svae,
    normalisation: Normalisation,
    views: usize,
    space: LatentSpace,
    native: LatentSpace,
}

impl NativeDecoder {
    /// The space that it decodes to: that of a folder with the same encoder, and neither adapter nor normalisation.
    pub fn native(&self) -> &LatentSpace {
        &self.native
    }

    /// Normalised latents (N, h, w, C) to features (N, h, w, D), f32.
    ///
    /// # Errors
    /// If the latents have another shape, or a feature is not finite.
    pub fn decode(&self, latents: &Tensor) -> Result<Tensor> {
        let (h, w, c) = self.space.shape();
        match latents.dims() {
            &[n, rows, columns, channels] if n > 0 && (rows, columns, channels) == (h, w, c) => {}
            _ => {
                return Err(shape_error(
                    "the latents",
                    format!("(N, {h}, {w}, {c})"),
                    latents,
                ));
            }
        }
        let mut values = latents
            .to_dtype(DType::F32)?
            .flatten_all()?
            .to_vec1::<f32>()?;
        self.normalisation.undo(&mut values);
        let latents = Tensor::from_vec(values, latents.dims(), &Device::Cpu)?;
        let features = self.adapter.decode(&views::apart(&latents, self.views)?)?;
        let features = views::beside(&features, self.views)?;
        let sum = features.sum_all()?.to_scalar::<f32>()?;
        if !sum.is_finite() {
            let what = "a feature from the adapter's decoder";
            return Err(Error::Model(wm_model::Error::NotFinite { what }));
        }
        Ok(features)
    }
}

impl DescribedFolder {
    /// Loads the adapter's decoder; `None` where the model's latents are the encoder's own.
    ///
    /// # Errors
    /// If a value is not finite.
    pub fn native_decoder(&self) -> Result<Option<NativeDecoder>> {
        let compute = self.in_own_format(&Compute::default())?;
        let Some(adapter) = load_adapter(self.adapter.as_ref(), &compute, &self.known)? else {
            return Ok(None);
        };
        let [rows, columns, _] = self.latent;
        let features = adapter.config().features;
        let name = format!("{} (native)", self.description.name);
        Ok(Some(NativeDecoder {
            adapter,
            normalisation: self.normalisation.clone(),
            views: self.views,
            space: self.space()?,
            native: self.space_of(
                name,
                ([rows, columns, features], self.description.dtype),
                None,
                &Normalisation::identity(features),
            )?,
        }))
    }

    /// Adds what a part's matrices are quantised with, if there is a calibration.
    pub(super) fn hash_ranges(&self, source: &Source, hash: &mut Sha256) {
        if let KnownInputs::Calibrated(calibration) = &self.known
            && let Some(ranges) = calibration.part(source.role)
        {
            hash.update(format!("{}\n", ranges.sha256()));
        }
    }

    /// The space of latents of this shape that the encoder, an adapter and a normalisation make with weights of this number
    /// format.
    pub(super) fn space_of(
        &self,
        name: String,
        (latent, format): ([usize; 3], NumberFormat),
        adapter: Option<&Opened<SvaeConfig>>,
        normalisation: &Normalisation,
    ) -> Result<LatentSpace> {
        let mut hash = Sha256::new();
        let [height, width, channels] = latent;
        let description = &self.description;
        let settings = (latent, description.image, self.views, format);
        hash.update(format!("{}\n", settings.canonical()?));
        if !description.fit.is_stretch() {
            hash.update(format!("{}\n", description.fit));
        }
        hash.update(format!("{}\n", self.encoder.config.canonical()?));
        self.encoder.source.hash(&self.encoder.tensors, &mut hash)?;
        if let Some(adapter) = adapter {
            hash.update(format!("{}\n", adapter.config.canonical()?));
            adapter.source.hash(&adapter.tensors, &mut hash)?;
        }
        normalisation.add_to(&mut hash);
        if format == NumberFormat::Int8 {
            self.hash_ranges(&self.encoder.source, &mut hash);
            if let Some(adapter) = adapter {
                self.hash_ranges(&adapter.source, &mut hash);
            }
        }
        Ok(LatentSpace {
            name,
            hash: format!("{:x}", hash.finalize()),
            height,
            width,
            channels,
        })
    }
}
