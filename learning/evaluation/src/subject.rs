//! A model with its evaluation data.

use std::{path::Path, sync::Arc};

use anyhow::{Context as _, Result, bail};
use candle_core::{Device, Tensor};
use image::RgbImage;
use wm_dataset::{Clip, ClipSource, Dataset, HeldOutArgs, Latents};
use wm_model::{
    Decoder, Encoder, WorldModel,
    image::to_rgb,
    sampler::{Given, Rollout, Sampler},
};
use wm_zoo::{ModelFolder, success_probe::SuccessClassifier};

use crate::{CONTEXT, Perception, ReaderArgs, Readers, readers::OWN_PROBE};

/// A model with all its parts, and held-out episodes in its latents.
pub struct Subject {
    /// Frames to latents.
    pub encoder: Box<dyn Encoder>,
    /// Latents to frames, if the model has a decoder.
    pub decoder: Option<Box<dyn Decoder>>,
    /// The transition model.
    pub world: WorldModel,
    /// Sampler: the model's own settings unless overridden.
    pub sampler: Sampler,
    /// Inverse dynamics models and success probes.
    pub readers: Readers,
    /// The frames.
    pub dataset: Dataset,
    /// Their latents.
    pub latents: Latents,
    /// Networks for decoded frames; none by default.
    pub perception: Arc<Perception>,
}

impl Subject {
    /// Opens the model `name` (`tiny`, or a folder) and the data.
    ///
    /// # Errors
    /// Names the unusable part: a model without a transition model, data of other actions, a broken file.
    pub fn open(name: &str, on: &HeldOutArgs, more: &ReaderArgs) -> Result<Self> {
        let folder = open_model(name)?;
        let dataset = on.open(folder.encoder()?.framing())?;
        let mut subject = Self::new(&folder, dataset, &on.cache())?;
        subject.readers.add(more, &folder)?;
        Ok(subject)
    }

    /// Loads a model, and encodes the data unless cached.
    ///
    /// # Errors
    /// Those of [`Self::open`].
    pub fn new(folder: &ModelFolder, dataset: Dataset, cache: &Path) -> Result<Self> {
        let encoder = folder.encoder()?;
        let world = folder.world_model()?;
        (world.encoding.space()).expect_same(dataset.action_space(), "the model", "the bags")?;
        let latents = Latents::open(&dataset, &*encoder, cache)?;
        Ok(Self {
            decoder: folder.decoder()?,
            encoder,
            sampler: world.transition.config().sampler.clone(),
            world,
            readers: Readers::of_folder(folder)?,
            dataset,
            latents,
            perception: Arc::default(),
        })
    }

    /// Frames `index`, `index + skip`, ... of an episode compared in a rollout of at most `steps` steps, observed ones
    /// first; empty if the episode is too short to predict any.
    #[must_use]
    pub fn frames_of(&self, episode: usize, steps: usize) -> Vec<usize> {
        let Some(episode) = self.dataset.episodes().get(episode) else {
            return Vec::new();
        };
        let indices = (0..episode.frame_count).step_by(self.world.encoding.frame_skip());
        let indices: Vec<usize> = indices.take(CONTEXT.saturating_add(steps)).collect();
        if indices.len() <= CONTEXT {
            return Vec::new();
        }
        let first = episode.first_frame;
        indices.into_iter().map(|index| first + index).collect()
    }

    /// The first `count` frames of an episode, one model step apart.
    ///
    /// # Errors
    /// If it is shorter.
    pub fn recording(&self, episode: usize, count: usize) -> Result<Recording> {
        let source = ClipSource::new(&self.latents, &self.world.encoding, count)?;
        let (frames, actions) = source.tensors(&[Clip::new(episode, 0)])?;
        Ok(Recording {
            frames: frames.squeeze(0)?,
            actions: actions.squeeze(0)?,
        })
    }

    /// A frame of the data.
    ///
    /// # Errors
    /// For an unknown index.
    pub fn frame(&self, index: usize) -> Result<RgbImage> {
        let (height, width) = self.dataset.size();
        let frame = self.dataset.frame(index);
        let frame = frame.with_context(|| format!("no frame {index}"))?;
        RgbImage::from_raw(width as u32, height as u32, frame.to_vec())
            .context("a frame of another size")
    }

    /// Decodes latents (N, h, w, C).
    ///
    /// # Errors
    /// If there is no decoder, or they do not fit it.
    pub fn decode(&self, latents: &Tensor) -> Result<Vec<RgbImage>> {
        let decoder = self
            .decoder
            .as_deref()
            .context("the model has no decoder")?;
        decode(decoder, latents)
    }

    /// Encodes pictures to latents (N, h, w, C).
    ///
    /// # Errors
    /// If they do not fit the encoder.
    pub fn encode(&self, pictures: &[RgbImage]) -> Result<Tensor> {
        let (height, width) = self.dataset.size();
        let latents = pictures.iter().map(|picture| {
            let values: Vec<f32> = picture
                .as_raw()
                .iter()
                .map(|v| f32::from(*v) / 255.0)
                .collect();
            let tensor = Tensor::from_vec(values, (1, height, width, 3), &Device::Cpu)?;
            Ok(self.encoder.encode(&tensor)?)
        });
        Ok(Tensor::cat(&latents.collect::<Result<Vec<_>>>()?, 0)?)
    }

    /// Name in reports, with the number of Euler steps if overridden.
    #[must_use]
    pub fn name(&self) -> String {
        let (name, steps) = (&self.world.name, self.sampler.steps);
        if self.sampler == self.world.transition.config().sampler {
            name.clone()
        } else {
            format!("{name} ({steps} Euler steps)")
        }
    }

    /// The model's own success probe.
    #[must_use]
    pub fn probe(&self) -> Option<&SuccessClassifier> {
        let first = self.readers.probes.first();
        first
            .filter(|own| own.name == OWN_PROBE)
            .map(|own| &own.model)
    }

    /// Sampler of predicted frames.
    #[must_use]
    pub fn sampler(&self) -> &Sampler {
        &self.sampler
    }

    /// Predicts after the first [`CONTEXT`] frames of a recording, under its actions, to its end: (K, h, w, C).
    ///
    /// # Errors
    /// If the recording does not fit the model.
    pub fn rollout(&self, recording: &Recording, seed: u64) -> Result<Tensor> {
        let Recording { frames, actions } = recording;
        predict(&self.world, self.sampler(), (frames, actions), seed)
    }
}

/// Decodes latents (N, h, w, C).
pub(crate) fn decode(decoder: &dyn Decoder, latents: &Tensor) -> Result<Vec<RgbImage>> {
    // One at a time bounds the memory of a large decoder.
    let pictures = (0..latents.dim(0)?).map(|at| {
        let picture = decoder.decode(&latents.narrow(0, at, 1)?.contiguous()?)?;
        Ok(to_rgb(&picture.squeeze(0)?)?)
    });
    pictures.collect()
}

/// Predicts after the first [`CONTEXT`] of the frames (N, h, w, C), under the actions (N, A), to their end.
pub(crate) fn predict(
    world: &WorldModel,
    sampler: &Sampler,
    (frames, actions): (&Tensor, &Tensor),
    seed: u64,
) -> Result<Tensor> {
    let context = frames.narrow(0, 0, CONTEXT)?.unsqueeze(0)?;
    let past = actions.narrow(0, 0, CONTEXT - 1)?;
    let mut rollout = Rollout::new(&world.transition, sampler, &context, Some(&past), seed)?;
    let predicted = (CONTEXT..frames.dim(0)?).map(|at| {
        let own = actions.narrow(0, at, 1)?;
        let given = Given {
            own_action: Some(&own),
            ..Given::default()
        };
        Ok(rollout.next_given(&actions.narrow(0, at - 1, 1)?, given)?)
    });
    Ok(Tensor::cat(&predicted.collect::<Result<Vec<_>>>()?, 0)?)
}

/// Opens the model `name` (`tiny`, or a folder) without loading it.
///
/// # Errors
/// If it does not exist, or has no transition model.
pub fn open_model(name: &str) -> Result<ModelFolder> {
    let folder = ModelFolder::open(name)?;
    if !folder.has_transition() {
        folder
            .space()
            .with_context(|| format!("{name}: not a model"))?;
        bail!(
            "{name} has no transition model to evaluate; train one: wm train transition --data \
             BAGS --encoder {name} --out {name}"
        );
    }
    Ok(folder)
}

/// Latents and actions, one model step apart.
#[derive(Clone, Debug)]
pub struct Recording {
    /// (N, h, w, C).
    pub frames: Tensor,
    /// (N, A): motion after each frame.
    pub actions: Tensor,
}
