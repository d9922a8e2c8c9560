use std::{collections::BTreeMap, path::Path};

use anyhow::Result;
use image::RgbImage;
use rand::Rng;
use rand_distr::{Distribution as _, StandardNormal};
use rayon::prelude::*;
use wm_dataset::Dataset;
use wm_evaluation::Figure;
use wm_model::{
    Autoencoder, AutoencoderConfig, Encoder as _,
    autoencoder::{Network, Normalisation, clamp, clamp_slope},
    ops::{ConvGradients, GridSize, Tape},
};

use super::{
    AutoencoderRecipe, crops,
    crops::Crops,
    error::TrainingError,
    evaluation::{evaluate, picture, pictures},
    salience::Salience,
};
use crate::{
    optimiser::{Group, Parameter, ParameterValues, step_rng},
    run::{Learner, StepLoss, Task},
    trained_weights::PRECISION,
};

/// Most frames in the normalisation of the latents.
const NORMALISATION_FRAMES: usize = 2000;
/// Frames of the final validation, and of one during the training.
const VALIDATION_FRAMES: [usize; 2] = [1000, 200];
/// Rows of the samples.
const SAMPLES: usize = 6;
/// File of the weights in a model's folder.
pub(super) const FILE: &str = Autoencoder::FILE;

/// An autoencoder in training.
pub(super) struct AutoencoderTask<'a> {
    recipe: AutoencoderRecipe,
    /// Number of steps.
    steps: u64,
    train: &'a Dataset,
    held_out: Option<&'a Dataset>,
    salience: Salience<'a>,
    model: Autoencoder,
    encoder: Half,
    decoder: Half,
    /// All parameters belong to the last one.
    groups: Vec<Group>,
    /// The model written last.
    written: Option<Autoencoder>,
}

#[derive(Default)]
struct Half {
    tape: Tape,
    gradient: ConvGradients,
}

/// Parts of a step's loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CropLoss {
    /// The minimised value.
    pub total: f32,
    /// Mean squared error of the crops.
    pub squared_error: f32,
    /// Mean square of the latents.
    pub latent_square: f32,
}

impl<'a> AutoencoderTask<'a> {
    /// A training of `steps` steps.
    ///
    /// # Errors
    /// For an invalid recipe, or pictures of another size.
    pub(super) fn new(
        recipe: AutoencoderRecipe,
        steps: u64,
        train: &'a Dataset,
        held_out: Option<&'a Dataset>,
    ) -> Result<Self, TrainingError> {
        let expected = (recipe.model.height, recipe.model.width);
        for found in [Some(train), held_out].into_iter().flatten() {
            if found.size() != expected {
                let found = found.size();
                return Err(TrainingError::FrameSize { expected, found });
            }
        }
        let config = AutoencoderConfig {
            fit: recipe.fit,
            trained_on: train.picture_size(),
            ..recipe.model.clone()
        };
        Ok(Self {
            model: Autoencoder::random(config, recipe.seed)?,
            recipe,
            steps,
            train,
            held_out,
            salience: Salience::new(train),
            encoder: Half::default(),
            decoder: Half::default(),
            groups: vec![Group::default()],
            written: None,
        })
    }

    /// Forward and backward through both halves.
    fn gradients(&mut self, crops: &Crops, rng: &mut impl Rng) -> Result<CropLoss, TrainingError> {
        let encoder = self.model.encoder();
        let latents = encoder.record(&mut self.encoder.tape, &crops.values, crops.grid)?;
        let factor = self.recipe.model.downsampling();
        let grid = GridSize {
            images: crops.grid.images,
            height: crops.grid.height / factor,
            width: crops.grid.width / factor,
        };
        let clamped: Vec<f32> = latents
            .iter()
            .map(|z| {
                let noise: f32 = StandardNormal.sample(rng);
                clamp(z + self.recipe.latent_noise * noise)
            })
            .collect();
        let decoder = self.model.decoder();
        let pictures = decoder.record(&mut self.decoder.tape, &clamped, grid)?;
        let (squared, loss, by_picture) = picture_loss(pictures, crops, self.recipe.squared);
        let mut by_latent = Vec::new();
        self.decoder.tape.backward(
            decoder.convs(),
            &by_picture,
            &mut self.decoder.gradient,
            Some(&mut by_latent),
        )?;
        let count = latents.len().max(1) as f32;
        let penalty = self.recipe.latent_penalty;
        let latent_square = latents.iter().map(|z| z * z).sum::<f32>() / count;
        for ((g, z), clamped) in by_latent.iter_mut().zip(latents).zip(&clamped) {
            *g = *g * clamp_slope(*clamped) + 2.0 * penalty * z / count;
        }
        self.encoder.tape.backward(
            encoder.convs(),
            &by_latent,
            &mut self.encoder.gradient,
            None,
        )?;
        Ok(CropLoss {
            total: loss + penalty * latent_square,
            squared_error: squared,
            latent_square,
        })
    }

    /// Length of the gradient of one half (0 encoder, 1 decoder) at step 0, and the slope of the loss along it by a central
    /// difference of half-width `step`.
    #[cfg(test)]
    pub(super) fn slope_along_gradient(
        &mut self,
        half: usize,
        step: f32,
    ) -> Result<(f32, f32), TrainingError> {
        let mut rng = step_rng(self.recipe.seed, 0);
        let crops = self.crops(0, &mut rng);
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

    /// Starts from another model of equal shape, whose weights belong to the second group.
    pub(super) fn begin_with(&mut self, old: &Autoencoder, groups: Vec<Group>) {
        let named = halves(old).into_iter().flat_map(|(half, network)| {
            network.convs().flat_map(move |conv| {
                let bias = conv.bias.as_deref().map(|bias| ("bias", bias));
                let parts = [Some(("weight", &*conv.weight)), bias];
                let parts = parts.into_iter().flatten();
                parts.map(move |(part, values)| (format!("{half}.{}.{part}", conv.name), values))
            })
        });
        let named: Vec<(String, &[f32])> = named.collect();
        let mut weights = named.iter().map(|(name, values)| ParameterValues {
            name,
            shape: &[],
            values,
        });
        assign(&mut self.model, &mut weights);
        self.groups = groups;
    }

    fn crops(&self, step: u64, rng: &mut impl Rng) -> Crops {
        let whole = step + self.recipe.whole_picture_steps(self.steps) >= self.steps;
        crops::draw(self.train, &self.salience, &self.recipe, whole, rng)
    }

    /// The autoencoder with these weights, and the normalisation of its latents over the training data.
    ///
    /// # Errors
    /// If a channel of the latents is constant.
    fn finished(
        &self,
        weights: &mut dyn Iterator<Item = ParameterValues<'_>>,
    ) -> Result<Autoencoder, TrainingError> {
        let mut model = self.model.clone();
        assign(&mut model, weights);
        let model = model.rounded(PRECISION);
        let count = self.train.frame_count();
        let stride = count.div_ceil(NORMALISATION_FRAMES).max(1);
        let frames: Vec<usize> = (0..count).step_by(stride).collect();
        // The model's normalisation is the identity here, so these are plain latents.
        let latents = frames
            .chunks(32)
            .map(|chunk| {
                let latents = model.encode(&pictures(self.train, chunk)?)?;
                Ok(latents.flatten_all()?.to_vec1::<f32>()?)
            })
            .collect::<Result<Vec<_>, TrainingError>>()?;
        let normalisation = Normalisation::of(latents, self.recipe.model.latent_channels)?;
        Ok(model.with_normalisation(normalisation)?)
    }
}

impl Learner for AutoencoderTask<'_> {
    fn parameters(&self) -> Result<Vec<Parameter>> {
        let mut parameters = BTreeMap::new();
        for (half, network) in halves(&self.model) {
            for conv in network.convs() {
                let name = format!("{half}.{}", conv.name);
                let shape = conv.shape;
                let dims = vec![shape.kernel, shape.kernel, shape.inputs, shape.outputs];
                parameters.insert(format!("{name}.weight"), (dims, conv.weight.clone()));
                if let Some(bias) = &conv.bias {
                    parameters.insert(format!("{name}.bias"), (vec![bias.len()], bias.clone()));
                }
            }
        }
        let parameters = parameters.into_iter();
        Ok(parameters
            .map(|(name, (shape, values))| Parameter {
                name,
                shape,
                values,
                group: self.groups.len().saturating_sub(1),
            })
            .collect())
    }

    fn groups(&self) -> Vec<Group> {
        self.groups.clone()
    }

    fn step(&mut self, step: u64) -> Result<StepLoss> {
        let mut rng = step_rng(self.recipe.seed, step);
        let crops = self.crops(step, &mut rng);
        let loss = self.gradients(&crops, &mut rng)?;
        let halves = [
            (self.model.encoder(), &mut self.encoder.gradient),
            (self.model.decoder(), &mut self.decoder.gradient),
        ];
        // By name, as the parameters.
        let mut named = BTreeMap::new();
        for ((network, gradient), half) in halves.into_iter().zip(["encoder", "decoder"]) {
            for (conv, (weight, bias)) in network.convs().zip(&mut gradient.convs) {
                let name = format!("{half}.{}", conv.name);
                named.insert(format!("{name}.weight"), std::mem::take(weight));
                if conv.bias.is_some() {
                    named.insert(format!("{name}.bias"), std::mem::take(bias));
                }
            }
        }
        Ok(StepLoss {
            loss: loss.total,
            parts: vec![
                ("squared_error", f64::from(loss.squared_error)),
                ("latent_square", f64::from(loss.latent_square)),
            ],
            gradient: named.into_values().collect(),
        })
    }

    fn assign(&mut self, weights: &mut dyn Iterator<Item = ParameterValues<'_>>) -> Result<()> {
        assign(&mut self.model, weights);
        Ok(())
    }
}

impl Task for AutoencoderTask<'_> {
    fn name(&self) -> &'static str {
        "autoencoder"
    }

    fn files(&self) -> &'static [&'static str] {
        &[FILE, wm_zoo::folder::FILE]
    }

    fn write(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
        folder: &Path,
    ) -> Result<()> {
        let model = self.finished(averaged)?;
        model.save(folder.join(FILE), PRECISION)?;
        wm_zoo::folder::describe_autoencoder(folder)?;
        self.written = Some(model);
        Ok(())
    }

    fn validate(&mut self, thorough: bool) -> Result<Vec<Figure>> {
        let (Some(held_out), Some(model)) = (self.held_out, &self.written) else {
            return Ok(Vec::new());
        };
        let [all, few] = VALIDATION_FRAMES;
        let found = evaluate(model, held_out, if thorough { all } else { few })?;
        let mut figures = vec![
            Figure::new("psnr", found.psnr),
            Figure::new("latent_std", found.latent_std),
        ];
        figures.extend(
            found
                .masked_psnr
                .map(|psnr| Figure::new("psnr_in_masks", psnr)),
        );
        Ok(figures)
    }

    fn samples(&mut self) -> Result<Option<RgbImage>> {
        let dataset = self.held_out.unwrap_or(self.train);
        let model = self.written.as_ref();
        Ok(model
            .map(|model| picture(model, dataset, SAMPLES))
            .transpose()?)
    }
}

/// Mean squared error, weighted loss |d| + squared d^2, and its gradient by the pictures.
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

fn assign(model: &mut Autoencoder, weights: &mut dyn Iterator<Item = ParameterValues<'_>>) {
    let mut weights: BTreeMap<&str, &[f32]> = weights
        .map(|trained| (trained.name, trained.values))
        .collect();
    let (encoder, decoder) = model.networks_mut();
    for (half, network) in [("encoder", encoder), ("decoder", decoder)] {
        for conv in network.convs_mut() {
            if let Some(weight) = weights.remove(format!("{half}.{}.weight", conv.name).as_str()) {
                conv.weight = weight.to_vec();
            }
            if let Some(bias) = weights.remove(format!("{half}.{}.bias", conv.name).as_str()) {
                conv.bias = Some(bias.to_vec());
            }
        }
    }
}
