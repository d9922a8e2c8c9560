use candle_core::{Device, Tensor};
use image::RgbImage;
use wm_dataset::Dataset;
use wm_evaluation::SquaredError;
use wm_model::{Autoencoder, Decoder as _, Encoder as _, image::to_rgb};

use super::error::TrainingError;

/// Reconstruction of frames by an autoencoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reconstruction {
    /// Number of frames.
    pub frames: usize,
    /// PSNR of the squared error over all pixels of all frames \[dB\].
    pub psnr: f64,
    /// PSNR inside masks (gripper and objects) \[dB\]; `None` without masks.
    pub masked_psnr: Option<f64>,
    /// Mean standard deviation of the normalised latents' channels; 1 on the training data.
    pub latent_std: f64,
}

impl std::fmt::Display for Reconstruction {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} frames: PSNR {:.2} dB", self.frames, self.psnr)?;
        if let Some(masked) = self.masked_psnr {
            write!(f, ", {masked:.2} dB inside the masks")?;
        }
        write!(f, ", latent standard deviation {:.2}", self.latent_std)
    }
}

/// Encodes and decodes at most `frames` frames spread over `dataset`.
///
/// # Errors
/// If the frames do not fit the autoencoder.
pub fn evaluate(
    autoencoder: &Autoencoder,
    dataset: &Dataset,
    frames: usize,
) -> Result<Reconstruction, TrainingError> {
    let stride = dataset.frame_count().div_ceil(frames.max(1)).max(1);
    let chosen: Vec<usize> = (0..dataset.frame_count()).step_by(stride).collect();
    let mut all = SquaredError::default();
    let mut masked = SquaredError::default();
    let (mut sum, mut squares, mut latents) = (0.0, 0.0, 0usize);
    for chunk in chosen.chunks(16) {
        let pictures = pictures(dataset, chunk)?;
        let codes = autoencoder.encode(&pictures)?;
        for v in codes.flatten_all()?.to_vec1::<f32>()? {
            sum += f64::from(v);
            squares += f64::from(v) * f64::from(v);
            latents += 1;
        }
        let decoded = autoencoder
            .decode(&codes)?
            .flatten_all()?
            .to_vec1::<f32>()?;
        let pictures = pictures.flatten_all()?.to_vec1::<f32>()?;
        let pixels = decoded.chunks_exact(3).zip(pictures.chunks_exact(3));
        let masks = chunk
            .iter()
            .flat_map(|frame| dataset.mask(*frame).unwrap_or_default());
        let mut masks = masks.copied();
        for (a, b) in pixels {
            let error: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum();
            all.add_pixel(error);
            if masks.next().is_some_and(|class| class > 0) {
                masked.add_pixel(error);
            }
        }
    }
    let count = latents.max(1) as f64;
    Ok(Reconstruction {
        frames: chosen.len(),
        // Without any error the ratio is infinite.
        psnr: all.psnr().unwrap_or(f64::INFINITY),
        masked_psnr: masked.psnr(),
        latent_std: (squares / count - (sum / count).powi(2)).max(0.0).sqrt(),
    })
}

/// `count` evenly spread frames, one per row: the frame, its reconstruction, and four times the difference.
///
/// # Errors
/// If the frames do not fit the autoencoder.
pub fn picture(
    autoencoder: &Autoencoder,
    dataset: &Dataset,
    count: usize,
) -> Result<RgbImage, TrainingError> {
    let count = count.clamp(1, dataset.frame_count().max(1));
    let chosen: Vec<usize> = (0..count)
        // From the middle of each stretch, since first frames of episodes are similar.
        .map(|i| (2 * i + 1) * dataset.frame_count() / (2 * count))
        .collect();
    let frames = pictures(dataset, &chosen)?;
    let decoded = autoencoder.decode(&autoencoder.encode(&frames)?)?;
    let difference = ((&frames - &decoded)?.abs()? * 4.0)?;
    let across = Tensor::cat(&[frames, decoded, difference], 2)?;
    let (rows, height, width, _) = across.dims4()?;
    Ok(to_rgb(&across.reshape((rows * height, width, 3))?)?)
}

/// Frames of a dataset as a tensor (N, H, W, 3) in 0..1.
pub(super) fn pictures(dataset: &Dataset, frames: &[usize]) -> Result<Tensor, candle_core::Error> {
    let (height, width) = dataset.size();
    let values: Vec<f32> = frames
        .iter()
        // A missing frame makes `from_vec` fail.
        .flat_map(|frame| dataset.frame(*frame).unwrap_or_default())
        .map(|v| f32::from(*v) / 255.0)
        .collect();
    Tensor::from_vec(values, (frames.len(), height, width, 3), &Device::Cpu)
}
