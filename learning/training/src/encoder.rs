//! Training of a small semantic encoder: a vision transformer whose features encode the actions between frames.
//!
//! The paper compares semantic encoders (DINO, SigLIP, V-JEPA), which do not reconstruct pictures, with encoders that
//! do. This one replaces the published semantic encoders where they are too large; no loss pulls it towards pixels. It
//! is trained with an inverse dynamics model on its features, which is discarded at the end. The encoder's last
//! LayerNorm keeps its features from vanishing.
//!
//! The output is a folder with a `model.json`, as of published encoders, for `wm train adapter`.

mod arguments;
mod files;
mod initial;
mod network;
mod recipe;

use std::path::Path;

use anyhow::{Context as _, Result};
use candle_core::{Device, Tensor};
use rand::Rng as _;
use rand_chacha::ChaCha8Rng;
use wm_dataset::{ClipSource, Dataset};
use wm_evaluation::{Figure, on_clips};
use wm_model::{Compute, Encoder, Kernels, PictureSize};
use wm_motion::actions::ActionEncoding;
use wm_zoo::{
    Dropout, Loader, WebDinoConfig,
    folder::{self, DescribedFolder},
    idm::{IdmNetwork, IdmNetworkConfig},
};

use crate::{
    arguments::RunArgs,
    idm::{self, QUICK_WINDOWS},
    network_variables::{NetworkLearner, NetworkVariables},
    optimiser::{ParameterValues, Variables},
    run::Task,
    workers::BatchLoss,
};
use network::{HEAD, Network, each_frame};

pub use arguments::TrainEncoderArgs;
pub use files::FILE;
pub use recipe::{EncoderModelRecipe, EncoderRecipe};

/// An encoder in training.
struct EncoderTask<'a> {
    recipe: &'a EncoderRecipe,
    encoder: WebDinoConfig,
    head: IdmNetworkConfig,
    clips: ClipSource<'a>,
    held_out: Option<ClipSource<'a>>,
    /// Size of the pictures in the bags, if equal.
    picture_size: Option<PictureSize>,
    variables: NetworkVariables,
    network: Network,
    /// The output written last.
    written: Option<SavedEncoder>,
}

/// The written encoder, with its training head.
struct SavedEncoder {
    encoder: Box<dyn Encoder>,
    head: IdmNetwork,
}

impl<'a> EncoderTask<'a> {
    fn new(
        recipe: &'a EncoderRecipe,
        encoder: WebDinoConfig,
        encoding: &'a ActionEncoding,
        (train, held_out): (&'a Dataset, Option<&'a Dataset>),
        run: &RunArgs,
    ) -> Result<Self> {
        let features = (encoder.grid(), encoder.grid(), encoder.hidden_size);
        let head = recipe.head.config(features, encoding).context("head")?;
        let fresh = run.fresh_weights(FILE, recipe.seed)?;
        initial::begin(&fresh, &encoder, &head)?;
        let network = Network::load(&encoder, &head, &fresh.loader())?;
        let window = head.horizon() + 1;
        let clips = |dataset: &'a Dataset, frames| ClipSource::new(dataset, encoding, frames);
        Ok(Self {
            clips: clips(train, head.horizon() + recipe.windows)?.on(&run.device()?),
            held_out: held_out
                .map(|dataset| clips(dataset, window))
                .transpose()
                .context("the held-out bags")?,
            picture_size: train.picture_size(),
            recipe,
            encoder,
            head,
            variables: NetworkVariables::fresh(fresh, recipe, run)?,
            network,
            written: None,
        })
    }

    fn loss(&self, rng: &mut ChaCha8Rng) -> Result<Tensor> {
        let (pictures, actions) = self.clips.batch(self.recipe.micro_batch, rng)?;
        let pictures = relit(&pictures, self.recipe.light, rng)?;
        let features = self.network.features(&pictures)?;
        let frames = self.head.horizon() + 1;
        let (features, actions) = (windows(&features, frames)?, windows(&actions, frames)?);
        let mut dropout = Dropout::new(self.recipe.dropout, rng);
        idm::loss(&self.network.head, (&features, &actions), &mut dropout)
    }
}

/// All windows of `frames` successive frames within clips (B, n, ...): (B * windows, frames, ...), ordered by their first
/// frame, then by clip.
fn windows(clips: &Tensor, frames: usize) -> Result<Tensor> {
    let starts = 0..=clips.dim(1)? - frames;
    let each = starts.map(|start| clips.narrow(1, start, frames));
    Ok(Tensor::cat(
        &each.collect::<candle_core::Result<Vec<_>>>()?,
        0,
    )?)
}

/// Pictures (B, n, H, W, 3) in 0..1 under other light, constant within a clip, so that changes between its frames come only
/// from the robot. Brightness and contrast change by at most `most`.
fn relit(pictures: &Tensor, most: f64, rng: &mut ChaCha8Rng) -> Result<Tensor> {
    let clips = pictures.dim(0)?;
    let mut around = |middle: f64| {
        let values = (0..clips).map(|_| (middle + rng.random_range(-most..=most)) as f32);
        Tensor::from_vec(
            values.collect::<Vec<_>>(),
            (clips, 1, 1, 1, 1),
            pictures.device(),
        )
    };
    let (contrast, grey) = (around(1.0)?, around(0.5)?);
    let lit = (pictures - 0.5)?
        .broadcast_mul(&contrast)?
        .broadcast_add(&grey)?;
    Ok(lit.clamp(0.0, 1.0)?)
}

impl NetworkLearner for EncoderTask<'_> {
    fn variables(&self) -> &NetworkVariables {
        &self.variables
    }

    fn batch_loss(&self, _step: u64, rng: &mut ChaCha8Rng) -> Result<BatchLoss> {
        Ok(BatchLoss::from(self.loss(rng)?))
    }

    fn follow(&mut self) -> Result<()> {
        // Loaded again, since the patch embedding stores its filters in another order than the variable.
        let loader = Loader::supplied(&self.variables.tensors, Kernels::Candle);
        self.network = Network::load(&self.encoder, &self.head, &loader)?;
        Ok(())
    }
}

impl Task for EncoderTask<'_> {
    fn name(&self) -> &'static str {
        "encoder"
    }

    fn files(&self) -> &'static [&'static str] {
        &[FILE, folder::FILE]
    }

    fn write(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
        folder: &Path,
    ) -> Result<()> {
        let (head, encoder): (Vec<_>, Vec<_>) =
            averaged.partition(|trained| trained.name.starts_with(HEAD));
        files::write_weights(folder, &self.encoder, encoder)?;
        let pictures = (self.recipe.fit, self.picture_size);
        files::write_description(folder, &self.encoder, self.recipe.name()?, pictures)?;
        let mut variables = Variables::default();
        for ParameterValues {
            name,
            shape,
            values,
        } in head
        {
            variables.add(name, &Tensor::from_slice(values, shape, &Device::Cpu)?)?;
        }
        let loader = Loader::supplied(&variables, Kernels::Cpu);
        self.written = Some(SavedEncoder {
            // From exactly the written files.
            encoder: DescribedFolder::open(folder)?.encoder(&Compute::default())?,
            head: network::load_head(&self.head, &loader)?,
        });
        Ok(())
    }

    fn validate(&mut self, thorough: bool) -> Result<Vec<Figure>> {
        let (Some(held_out), Some(SavedEncoder { encoder, head })) =
            (&self.held_out, &self.written)
        else {
            return Ok(Vec::new());
        };
        let most = if thorough { usize::MAX } else { QUICK_WINDOWS };
        let found = on_clips(held_out, most, |pictures| {
            let features = each_frame(pictures, |pictures| Ok(encoder.encode(pictures)?))?;
            Ok(head.forward(&features)?)
        })?;
        Ok(found.figures())
    }
}

#[cfg(test)]
mod tests;
