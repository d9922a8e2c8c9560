//! Training of the S-VAE adapter and its pixel decoder (the paper, appendix B.3 and B.4) on the features of a frozen
//! encoder.
//!
//! The adapter minimises the error of features reconstructed from a sample of its latent, and the latent's divergence
//! from a unit Gaussian. The pixel decoder minimises the error of pictures decoded from the detached latent, so no
//! pixel gradient reaches the adapter. It sees the mean of the latent: the paper does not specify mean or sample, and
//! the world model predicts and decodes the mean. Both step at once, as separate groups.

mod arguments;
mod evaluation;
mod feature_loss;
mod files;
mod frames;
mod ms_ssim;
mod objective;
mod pixel_loss;
mod recipe;

use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use candle_core::Device;
use image::RgbImage;
use rand::Rng as _;
use rand_chacha::ChaCha8Rng;
use wm_evaluation::Figure;
use wm_zoo::{Checkpoint, lpips::Lpips};

use crate::{
    arguments::RunArgs,
    network_variables::{NetworkLearner, NetworkVariables},
    optimiser::{Group, ParameterValues},
    run::Task,
    transition::normals,
    workers::BatchLoss,
};
use evaluation::SavedNetworks;
use files::{Output, PIXEL_DECODER};
use objective::{Losses, Objective};

pub use arguments::TrainAdapterArgs;
pub use evaluation::Reconstruction;
pub use files::{FILE, STATISTICS};
pub use frames::Frames;
pub use ms_ssim::MsSsim;
pub use recipe::{AdapterModelRecipe, AdapterRecipe, LossRecipe};

/// Frames of a validation during the training, and of the final one.
const VALIDATION_FRAMES: [usize; 2] = [64, 1000];
/// Rows of the samples.
const SAMPLES: usize = 6;

/// Training data of an adapter.
struct Data<'a> {
    /// The frames.
    train: Frames<'a>,
    /// Frames of the validation.
    held_out: Option<Frames<'a>>,
    /// Perceptual distance, if its networks are given.
    lpips: Option<Lpips>,
    /// Weights to start from.
    start: Option<Checkpoint>,
    /// The description of the encoder's folder, if it has one.
    description: Option<serde_json::Value>,
}

/// An adapter in training.
struct AdapterTask<'a> {
    recipe: &'a AdapterRecipe,
    data: &'a Data<'a>,
    variables: NetworkVariables,
    objective: Objective<'a>,
    device: Device,
    /// The networks written last.
    written: Option<SavedNetworks>,
}

impl<'a> AdapterTask<'a> {
    fn new(
        recipe: &'a AdapterRecipe,
        steps: u64,
        data: &'a Data<'a>,
        run: &RunArgs,
    ) -> Result<Self> {
        if let Some(held_out) = &data.held_out {
            ensure!(
                held_out.space() == data.train.space(),
                "the held-out frames are in the latent space {}, the others in {}",
                held_out.space(),
                data.train.space()
            );
        }
        let view = data.train.view(recipe.views)?;
        let compute = run.compute_f32()?;
        let lpips = data.lpips.as_ref();
        let (objective, variables) = Objective::new(recipe, view, steps, lpips, &compute)?;
        if let Some(start) = &data.start {
            files::start_from(start, &variables)?;
        }
        // All weights of a fine-tuned model are old.
        let rate = data.start.as_ref().map_or(1.0, |_| run.old_rate);
        let groups = [1.0, recipe.pixel_decoder_rate].map(|own| Group { rate: own * rate });
        let of_pixels = variables
            .names()
            .filter(|name| name.starts_with(PIXEL_DECODER));
        let of_pixels = of_pixels.map(str::to_owned).collect();
        let variables = NetworkVariables::new(variables, recipe, run)?;
        Ok(Self {
            recipe,
            data,
            variables: variables.in_groups(groups.into(), of_pixels),
            objective,
            device: compute.device()?.clone(),
            written: None,
        })
    }

    /// Losses on frames drawn by `rng`.
    fn drawn(&self, rng: &mut ChaCha8Rng, step: u64) -> Result<Losses> {
        let train = &self.data.train;
        let frames: Vec<usize> = (0..self.recipe.micro_batch)
            .map(|_| rng.random_range(0..train.count()))
            .collect();
        let (features, pictures) = train.of(&frames, self.recipe.views)?;
        let (n, h, w, _) = features.dims4()?;
        let channels = self.objective.svae().latent;
        let noise = normals(&[n, h, w, channels], &self.device, rng)?;
        let [features, pictures] = [features, pictures].map(|x| x.to_device(&self.device));
        let (features, pictures) = (features?, pictures?);
        self.objective.losses(&features, &pictures, &noise, step)
    }
}

impl NetworkLearner for AdapterTask<'_> {
    fn variables(&self) -> &NetworkVariables {
        &self.variables
    }

    fn batch_loss(&self, step: u64, rng: &mut ChaCha8Rng) -> Result<BatchLoss> {
        let losses = self.drawn(rng, step)?;
        Ok(BatchLoss {
            parts: losses.parts,
            ..BatchLoss::from((losses.adapter + losses.pixel)?)
        })
    }
}

impl Task for AdapterTask<'_> {
    fn name(&self) -> &'static str {
        "adapter"
    }

    fn files(&self) -> &'static [&'static str] {
        &[FILE, STATISTICS, wm_zoo::folder::FILE]
    }

    fn write(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
        folder: &Path,
    ) -> Result<()> {
        let output = Output {
            folder,
            svae: self.objective.svae(),
            pixel: &self.objective.decoder_config,
            space: self.data.train.space(),
        };
        output.write_weights(averaged)?;
        // From exactly the written file.
        let written = SavedNetworks::open(&output, self.recipe.views)?;
        let statistics = written
            .statistics(&self.data.train)
            .context("the statistics of the latents")?;
        output.write_statistics(&statistics)?;
        if let Some(description) = &self.data.description {
            output.write_description(description, self.recipe.views)?;
        }
        self.written = Some(written);
        Ok(())
    }

    fn validate(&mut self, thorough: bool) -> Result<Vec<Figure>> {
        let (Some(held_out), Some(written)) = (&self.data.held_out, &self.written) else {
            return Ok(Vec::new());
        };
        let [quick, all] = VALIDATION_FRAMES;
        let most = if thorough { all } else { quick };
        Ok(written.reconstruct(held_out, most)?.figures())
    }

    fn samples(&mut self) -> Result<Option<RgbImage>> {
        let frames = self.data.held_out.as_ref().unwrap_or(&self.data.train);
        let written = self.written.as_ref();
        written
            .map(|written| written.picture(frames, SAMPLES))
            .transpose()
    }
}

#[cfg(test)]
mod tests;
