use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use candle_core::{Device, Tensor, Var};
use indicatif::{ProgressBar, ProgressStyle};
use rand::Rng;
use rand_distr::{Distribution as _, StandardNormal};
use rayon::prelude::*;
use thiserror::Error;
use wm_model::{
    Autoencoder, Encoder as _,
    autoencoder::{Network, NetworkGradient, Normalisation, Tape, clamp, clamp_slope},
    ops::GridSize,
    weights::Precision,
};

use super::{AutoencoderSettings, crops, crops::Crops, salience::Salience};
use crate::{
    dataset::{Dataset, DatasetError},
    loss_curve::LossCurve,
    optimiser::{AdamW, AdamWSettings, OptimiserError, Schedule, step_rng},
};

/// Steps between two lines of the log, where the progress bar is not seen.
const LOG_STEPS: u64 = 100;
/// Frames that the normalisation of the latents is taken over, at most; and while the training goes on.
const NORMALISATION_FRAMES: usize = 2000;
const INTERIM_FRAMES: usize = 200;
/// Weights are saved as half floats.
const PRECISION: Precision = Precision::F16;

/// Why a training stopped.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TrainingError {
    /// The data cannot be used.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The model cannot be made, run or saved.
    #[error(transparent)]
    Model(#[from] wm_model::Error),
    /// A step or a checkpoint failed.
    #[error(transparent)]
    Optimiser(#[from] OptimiserError),
    /// A tensor operation failed.
    #[error(transparent)]
    Tensor(#[from] candle_core::Error),
    /// A file cannot be written.
    #[error("{path}: {source}", path = .path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The pictures have another size than the model.
    #[error("the frames are {found:?} (height, width), expected {expected:?}")]
    FrameSize {
        /// What the model takes.
        expected: (usize, usize),
        /// What the dataset has.
        found: (usize, usize),
    },
}

/// An autoencoder in training.
pub(super) struct AutoencoderRun {
    settings: AutoencoderSettings,
    /// Settings and data, as the checkpoint names them.
    run: String,
    model: Autoencoder,
    optimiser: AdamW,
    schedule: Schedule,
    encoder: Half,
    decoder: Half,
}

#[derive(Default)]
struct Half {
    tape: Tape,
    gradient: NetworkGradient,
}

/// The parts of a step's loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StepLoss {
    /// What is minimised.
    pub total: f32,
    /// Mean squared error of the crops.
    pub squared_error: f32,
    /// Mean square of the latents.
    pub latent_square: f32,
}

impl AutoencoderRun {
    /// A run at step 0 over the data of digest `data`.
    ///
    /// # Errors
    /// When the settings make no sense.
    pub(super) fn new(settings: AutoencoderSettings, data: &str) -> Result<Self, TrainingError> {
        let model = Autoencoder::random(settings.model.clone(), settings.seed)?;
        let optimiser = AdamW::new(
            &variables(&model)?,
            AdamWSettings {
                ema_decay: settings.ema_decay,
                ..AdamWSettings::default()
            },
        )?;
        let schedule = Schedule::new(
            settings.learning_rate,
            settings.warm_up_steps,
            settings.steps,
            settings.final_rate,
        );
        let run = serde_json::json!({"settings": settings, "data": data}).to_string();
        Ok(Self {
            settings,
            run,
            model,
            optimiser,
            schedule,
            encoder: Half::default(),
            decoder: Half::default(),
        })
    }

    /// Steps taken so far.
    pub(super) fn steps_taken(&self) -> u64 {
        self.optimiser.steps_taken()
    }

    /// Writes the whole state.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(super) fn save(&mut self, path: &Path) -> Result<(), TrainingError> {
        Ok(self.optimiser.save(path, &self.run)?)
    }

    /// Takes up the state that [`Self::save`] wrote with the same settings and data.
    ///
    /// # Errors
    /// When the file is of another run or broken.
    pub(super) fn resume(&mut self, path: &Path) -> Result<(), TrainingError> {
        self.optimiser.resume(path, &self.run)?;
        self.load_weights();
        Ok(())
    }

    /// One step on the crops that belong to it.
    pub(super) fn step(
        &mut self,
        dataset: &Dataset,
        salience: &Salience<'_>,
    ) -> Result<StepLoss, TrainingError> {
        let step = self.optimiser.steps_taken();
        let mut rng = step_rng(self.settings.seed, step);
        let crops = crops::draw(dataset, salience, &self.settings, step, &mut rng);
        let loss = self.gradients(&crops, &mut rng)?;
        let halves = [
            (self.model.encoder(), &mut self.encoder.gradient),
            (self.model.decoder(), &mut self.decoder.gradient),
        ];
        let mut named = BTreeMap::new();
        for ((network, gradient), half) in halves.into_iter().zip(["encoder", "decoder"]) {
            for (conv, (weight, bias)) in network.convs().iter().zip(&mut gradient.convs) {
                let name = format!("{half}.{}", conv.name);
                named.insert(format!("{name}.weight"), std::mem::take(weight));
                if conv.bias.is_some() {
                    named.insert(format!("{name}.bias"), std::mem::take(bias));
                }
            }
        }
        let gradients: Vec<Vec<f32>> = named.into_values().collect();
        self.optimiser
            .step_along(&gradients, self.schedule.at(step))?;
        self.load_weights();
        Ok(loss)
    }

    /// Forward and backward through both halves.
    fn gradients(&mut self, crops: &Crops, rng: &mut impl Rng) -> Result<StepLoss, TrainingError> {
        let latents = self
            .encoder
            .tape
            .forward(self.model.encoder(), &crops.values, crops.grid)?;
        let factor = self.settings.model.downsampling();
        let grid = GridSize {
            images: crops.grid.images,
            height: crops.grid.height / factor,
            width: crops.grid.width / factor,
        };
        let clamped: Vec<f32> = latents
            .iter()
            .map(|z| {
                let noise: f32 = StandardNormal.sample(rng);
                clamp(z + self.settings.latent_noise * noise)
            })
            .collect();
        let pictures = self
            .decoder
            .tape
            .forward(self.model.decoder(), &clamped, grid)?;
        let (squared, loss, by_picture) = picture_loss(pictures, crops, self.settings.squared);
        let mut by_latent = Vec::new();
        self.decoder.tape.backward(
            self.model.decoder(),
            &by_picture,
            &mut self.decoder.gradient,
            Some(&mut by_latent),
        )?;
        let count = latents.len().max(1) as f32;
        let penalty = self.settings.latent_penalty;
        let latent_square = latents.iter().map(|z| z * z).sum::<f32>() / count;
        for ((g, z), clamped) in by_latent.iter_mut().zip(latents).zip(&clamped) {
            *g = *g * clamp_slope(*clamped) + 2.0 * penalty * z / count;
        }
        self.encoder.tape.backward(
            self.model.encoder(),
            &by_latent,
            &mut self.encoder.gradient,
            None,
        )?;
        Ok(StepLoss {
            total: loss + penalty * latent_square,
            squared_error: squared,
            latent_square,
        })
    }

    /// The length of the gradient of one half (0 encoder, 1 decoder) at step 0, and the slope of the loss along it by
    /// a central difference of half-width `step`.
    #[cfg(test)]
    pub(super) fn slope_along_gradient(
        &mut self,
        dataset: &Dataset,
        salience: &Salience<'_>,
        half: usize,
        step: f32,
    ) -> Result<(f32, f32), TrainingError> {
        let mut rng = step_rng(self.settings.seed, 0);
        let crops = crops::draw(dataset, salience, &self.settings, 0, &mut rng);
        let start = self.model.clone();
        self.gradients(&crops, &mut rng.clone())?;
        let gradient = [&self.encoder.gradient, &self.decoder.gradient][half].clone();
        let squares = gradient
            .convs
            .iter()
            .flat_map(|(weight, bias)| weight.iter().chain(bias));
        let length = squares.map(|g| g * g).sum::<f32>().sqrt();
        let mut losses = [0.0; 2];
        for (loss, sign) in losses.iter_mut().zip([1.0, -1.0]) {
            self.model = start.clone();
            let (encoder, decoder) = self.model.networks_mut();
            let network = [encoder, decoder].into_iter().nth(half);
            let convs = network.into_iter().flat_map(|network| network.convs_mut());
            for (conv, (weight, bias)) in convs.zip(&gradient.convs) {
                let weights = conv.weight.iter_mut().chain(conv.bias.iter_mut().flatten());
                for (w, g) in weights.zip(weight.iter().chain(bias)) {
                    *w += sign * step * g / length;
                }
            }
            *loss = self.gradients(&crops, &mut rng.clone())?.total;
        }
        self.model = start;
        Ok((length, (losses[0] - losses[1]) / (2.0 * step)))
    }

    fn load_weights(&mut self) {
        let weights = self.optimiser.weights();
        let named = weights
            .map(|(name, values)| (name.to_owned(), values.to_vec()))
            .collect();
        assign(&mut self.model, named);
    }

    /// The autoencoder with the averaged weights and the normalisation of its latents over at most `frames` frames of
    /// `dataset`.
    ///
    /// # Errors
    /// When a channel of the latents does not vary.
    pub(super) fn finished(
        &self,
        dataset: &Dataset,
        frames: usize,
    ) -> Result<Autoencoder, TrainingError> {
        let mut model = self.model.clone();
        let mut averaged = BTreeMap::new();
        for (name, tensor) in self.optimiser.ema()? {
            averaged.insert(name, tensor.flatten_all()?.to_vec1::<f32>()?);
        }
        assign(&mut model, averaged);
        let model = model.rounded(PRECISION);
        let stride = dataset.frame_count().div_ceil(frames.max(1)).max(1);
        let frames: Vec<usize> = (0..dataset.frame_count()).step_by(stride).collect();
        // The model has the identity as normalisation here, so these are the plain latents.
        let latents = frames
            .chunks(32)
            .map(|chunk| {
                let latents = model.encode(&pictures(dataset, chunk)?)?;
                Ok(latents.flatten_all()?.to_vec1::<f32>()?)
            })
            .collect::<Result<Vec<_>, TrainingError>>()?;
        let normalisation = Normalisation::of(latents, self.settings.model.latent_channels)?;
        Ok(model.with_normalisation(normalisation)?)
    }
}

/// Frames of a dataset as a tensor (N, H, W, 3) in 0..1.
pub(super) fn pictures(dataset: &Dataset, frames: &[usize]) -> Result<Tensor, candle_core::Error> {
    let (height, width) = dataset.size();
    let values: Vec<f32> = frames
        .iter()
        .flat_map(|frame| dataset.frame(*frame).unwrap_or_default())
        .map(|v| f32::from(*v) / 255.0)
        .collect();
    Tensor::from_vec(values, (frames.len(), height, width, 3), &Device::Cpu)
}

/// The mean squared error, the weighted loss |d| + squared d^2, and its gradient by the pictures.
fn picture_loss(pictures: &[f32], crops: &Crops, squared: f32) -> (f32, f32, Vec<f32>) {
    let count = pictures.len().max(1) as f32;
    let mut gradient = vec![0.0; pictures.len()];
    let row = crops.grid.width;
    let sums: Vec<(f64, f64)> = gradient
        .par_chunks_mut(row * 3)
        .zip(pictures.par_chunks(row * 3))
        .zip(crops.values.par_chunks(row * 3))
        .zip(crops.weights.par_chunks(row))
        .map(|(((gradient, pictures), targets), weights)| {
            let mut sums = (0.0, 0.0);
            let pixels = gradient
                .chunks_exact_mut(3)
                .zip(pictures.chunks_exact(3))
                .zip(targets.chunks_exact(3));
            for (((gradient, picture), target), weight) in pixels.zip(weights) {
                for ((g, p), t) in gradient.iter_mut().zip(picture).zip(target) {
                    let d = p - t;
                    let sign = if d == 0.0 { 0.0 } else { d.signum() };
                    *g = weight * (sign + 2.0 * squared * d) / count;
                    sums.0 += f64::from(d * d);
                    sums.1 += f64::from(weight * (d.abs() + squared * d * d));
                }
            }
            sums
        })
        .collect();
    let (mut error, mut loss) = (0.0, 0.0);
    for (e, l) in sums {
        error += e;
        loss += l;
    }
    let count = f64::from(count);
    ((error / count) as f32, (loss / count) as f32, gradient)
}

fn halves(model: &Autoencoder) -> [(&'static str, &Network); 2] {
    [("encoder", model.encoder()), ("decoder", model.decoder())]
}

fn variables(model: &Autoencoder) -> Result<BTreeMap<String, Var>, TrainingError> {
    let mut variables = BTreeMap::new();
    for (half, network) in halves(model) {
        for conv in network.convs() {
            let name = format!("{half}.{}", conv.name);
            let shape = conv.shape;
            let dims = (shape.kernel, shape.kernel, shape.inputs, shape.outputs);
            let weight = Var::from_slice(&conv.weight, dims, &Device::Cpu)?;
            variables.insert(format!("{name}.weight"), weight);
            if let Some(bias) = &conv.bias {
                let bias = Var::from_slice(bias, bias.len(), &Device::Cpu)?;
                variables.insert(format!("{name}.bias"), bias);
            }
        }
    }
    Ok(variables)
}

fn assign(model: &mut Autoencoder, mut weights: BTreeMap<String, Vec<f32>>) {
    let (encoder, decoder) = model.networks_mut();
    for (half, network) in [("encoder", encoder), ("decoder", decoder)] {
        for conv in network.convs_mut() {
            if let Some(weight) = weights.remove(&format!("{half}.{}.weight", conv.name)) {
                conv.weight = weight;
            }
            if let Some(bias) = weights.remove(&format!("{half}.{}.bias", conv.name)) {
                conv.bias = Some(bias);
            }
        }
    }
}

/// Trains to the end and writes `autoencoder.safetensors`, `checkpoint.safetensors`, `loss.csv` and `loss.svg` into
/// `out`; takes up a checkpoint that is there. `checkpoint_every` is wall-clock time.
///
/// # Errors
/// When the data do not fit the model, or a file cannot be written.
pub fn train(
    dataset: &Dataset,
    settings: AutoencoderSettings,
    out: &Path,
    checkpoint_every: Duration,
) -> Result<Autoencoder, TrainingError> {
    let expected = (settings.model.height, settings.model.width);
    if dataset.size() != expected {
        return Err(TrainingError::FrameSize {
            expected,
            found: dataset.size(),
        });
    }
    let io = |source| TrainingError::Io {
        path: out.to_owned(),
        source,
    };
    std::fs::create_dir_all(out).map_err(io)?;
    let steps = settings.steps;
    let mut run = AutoencoderRun::new(settings, dataset.digest())?;
    let checkpoint = out.join("checkpoint.safetensors");
    if checkpoint.is_file() {
        run.resume(&checkpoint)?;
        tracing::info!("resumed at step {} of {steps}", run.steps_taken());
    }
    let mut curve = LossCurve::resume(out, run.steps_taken()).map_err(io)?;
    let salience = Salience::new(dataset);
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} {msg}, {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let progress = ProgressBar::new(steps).with_style(style);
    let mut saved = Instant::now();
    while run.steps_taken() < steps {
        let step = run.steps_taken();
        let loss = run.step(dataset, &salience)?;
        curve.push(step, loss.total);
        progress.set_position(step + 1);
        progress.set_message(format!("loss {:.4}", curve.recent_mean(50)));
        if progress.is_hidden() && step % LOG_STEPS == LOG_STEPS - 1 {
            let psnr = -10.0 * loss.squared_error.log10();
            let mean = curve.recent_mean(LOG_STEPS as usize);
            tracing::info!(
                "step {} loss {mean:.5}, last crops {psnr:.1} dB, latent square {:.2}",
                step + 1,
                loss.latent_square
            );
        }
        if saved.elapsed() >= checkpoint_every {
            run.save(&checkpoint)?;
            curve.write(out, "autoencoder").map_err(io)?;
            run.finished(dataset, INTERIM_FRAMES)?
                .save(out.join("autoencoder.safetensors"), PRECISION)?;
            saved = Instant::now();
        }
    }
    progress.finish_and_clear();
    run.save(&checkpoint)?;
    curve.write(out, "autoencoder").map_err(io)?;
    let autoencoder = run.finished(dataset, NORMALISATION_FRAMES)?;
    autoencoder.save(out.join("autoencoder.safetensors"), PRECISION)?;
    Ok(autoencoder)
}
