use std::fmt;

use anyhow::Result;
use candle_core::Tensor;
use image::RgbImage;
use wm_evaluation::{Figure, SquaredError};
use wm_model::{Compute, autoencoder::Normalisation, image::to_rgb};
use wm_zoo::{Checkpoint, Loader, PixelDecoder, Svae};

use super::{
    Frames,
    feature_loss::cosines,
    files::{ADAPTER, Output, PIXEL_DECODER},
};

/// Frames that are computed at once.
const BATCH: usize = 8;
/// Frames that the statistics of the latents are taken over, at most.
const STATISTICS_FRAMES: usize = 1000;

/// How well features and pictures come back from the mean of their latent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reconstruction {
    /// Frames looked at.
    pub frames: usize,
    /// Mean cosine between a token's features and what comes back.
    pub cosine: f64,
    /// Mean squared error of the features.
    pub squared_error: f64,
    /// PSNR in dB of the squared error over all pixels of all frames.
    pub psnr: f64,
}

impl Reconstruction {
    /// The figures of a validation.
    #[must_use]
    pub fn figures(&self) -> Vec<Figure> {
        vec![
            Figure::new("feature_cosine", self.cosine),
            Figure::new("feature_mse", self.squared_error),
            Figure::new("psnr", self.psnr),
        ]
    }
}

impl fmt::Display for Reconstruction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} frames: features of cosine {:.4} and squared error {:.4}, pictures of {:.2} dB",
            self.frames, self.cosine, self.squared_error, self.psnr
        )
    }
}

/// Networks as they are in a file.
pub(super) struct Written {
    adapter: Svae,
    decoder: PixelDecoder,
    views: usize,
}

impl Written {
    pub(super) fn open(output: &Output<'_>, views: usize) -> Result<Self> {
        let checkpoint = Checkpoint::open(output.weights())?;
        let adapter = checkpoint.require_part(ADAPTER)?;
        let decoder = checkpoint.require_part(PIXEL_DECODER)?;
        let (of_adapter, of_decoder) = (
            Loader::new(&adapter, &Compute::default())?,
            Loader::new(&decoder, &Compute::default())?,
        );
        let written = Self {
            adapter: Svae::load(output.svae, &of_adapter)?,
            decoder: PixelDecoder::load(output.pixel, &of_decoder)?,
            views,
        };
        of_adapter.finish()?;
        of_decoder.finish()?;
        Ok(written)
    }

    /// Mean and standard deviation of each channel of the latents.
    pub(super) fn statistics(&self, frames: &Frames<'_>) -> Result<Normalisation> {
        let chosen = frames.spread(STATISTICS_FRAMES);
        let latents = chosen
            .chunks(BATCH)
            .map(|batch| {
                let (features, _) = frames.of(batch, self.views)?;
                let latents = self.adapter.encode(&features)?;
                Ok(latents.flatten_all()?.to_vec1::<f32>()?)
            })
            .collect::<Result<Vec<_>>>()?;
        let channels = self.adapter.config().latent;
        Ok(Normalisation::of(latents, channels)?)
    }

    /// On at most `most` frames, spread over all.
    pub(super) fn reconstruct(&self, frames: &Frames<'_>, most: usize) -> Result<Reconstruction> {
        let chosen = frames.spread(most);
        let (mut cosine, mut squared, mut weight) = (0.0, 0.0, 0.0);
        let mut pixels = SquaredError::default();
        for batch in chosen.chunks(BATCH) {
            let (features, pictures) = frames.of(batch, self.views)?;
            let latent = self.adapter.encode(&features)?;
            let found = self.adapter.decode(&latent)?;
            let mean = |x: Tensor| -> Result<f64> {
                Ok(f64::from(x.mean_all()?.to_scalar::<f32>()?) * batch.len() as f64)
            };
            cosine += mean(cosines(&features, &found)?)?;
            squared += mean((found - features)?.sqr()?)?;
            weight += batch.len() as f64;
            let errors = (self.decoder.decode(&latent)? - pictures)?.sqr()?.sum(3)?;
            for error in errors.flatten_all()?.to_vec1::<f32>()? {
                pixels.add_pixel(f64::from(error));
            }
        }
        Ok(Reconstruction {
            frames: chosen.len(),
            cosine: cosine / weight,
            squared_error: squared / weight,
            psnr: pixels.psnr().unwrap_or(f64::INFINITY),
        })
    }

    /// `count` frames spread over `frames`, a row each: the frame, what is decoded, and four times the difference.
    pub(super) fn picture(&self, frames: &Frames<'_>, count: usize) -> Result<RgbImage> {
        let count = count.clamp(1, frames.count());
        let chosen: Vec<usize> = (0..count)
            // From the middle of each stretch: the first frames of episodes are much alike.
            .map(|i| (2 * i + 1) * frames.count() / (2 * count))
            .collect();
        let (features, pictures) = frames.of(&chosen, self.views)?;
        let decoded = self.decoder.decode(&self.adapter.encode(&features)?)?;
        let difference = ((&pictures - &decoded)?.abs()? * 4.0)?;
        let across = Tensor::cat(&[pictures, decoded, difference], 2)?;
        let (rows, height, width, _) = across.dims4()?;
        Ok(to_rgb(&across.reshape((rows * height, width, 3))?)?)
    }
}
