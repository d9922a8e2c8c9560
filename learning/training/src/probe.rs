//! Training of the success probe, which decides whether an episode follows its instruction (the paper, appendix B.7),
//! by binary cross-entropy on the latents of a frozen encoder.
//!
//! Samples are successes, failures, and successes under another episode's instruction. The best weights of all
//! validations are kept, not the last ones.

mod arguments;
mod episodes;
mod loss;
mod recipe;
mod text;
mod things;

use std::{
    collections::{BTreeMap, btree_map::Entry},
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, bail};
use candle_core::{Device, Tensor};
use rand::Rng as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use wm_dataset::Latents;
use wm_evaluation::{Accuracy, Figure};
use wm_model::{Kernels, Weights, weights::WeightsBuilder};
use wm_zoo::{
    Dropout, Loader, PROBE_FILE as FILE,
    loader::OfWeights,
    success_probe::{
        PLACE_FEATURES, PROBE_KEY, ProbeNetwork, ProbeNetworkConfig, Reader, Reading,
        WORD_FEATURES, WORDS_KEY, WordsConfig,
    },
};

use crate::{
    arguments::RunArgs,
    network_variables::{NetworkLearner, NetworkVariables},
    optimiser::ParameterValues,
    run::Task,
    trained_weights::trained_weights,
    transition::normals,
    workers::BatchLoss,
};
pub use arguments::{EvaluateProbeArgs, TrainProbeArgs};
use episodes::{Episodes, Negatives, Sample, Shares};
use loss::loss;
use text::{Text, Tower};
use things::Things;

pub use recipe::{ProbeKind, ProbeModelRecipe, ProbeRecipe};

/// Most episodes of a validation; always the same ones, since they select the weights.
const EPISODES: usize = 700;
/// Metadata key of the figures that selected the weights.
const VALIDATION_KEY: &str = "validation";
/// Metadata key of the camera frames between frames of the probe.
const FRAME_SKIP_KEY: &str = "frame_skip";

/// A success probe in training.
struct ProbeTask<'a> {
    recipe: &'a ProbeRecipe,
    out: &'a Path,
    train: &'a Latents,
    episodes: Episodes<'a>,
    held_out: Option<Episodes<'a>>,
    /// Locations of things, for a grounded probe.
    things: Option<Things<'a>>,
    config: ProbeNetworkConfig,
    text: Text,
    model: ProbeNetwork,
    variables: NetworkVariables,
    device: Device,
    /// The last averaged weights, and their file.
    candidate: Option<(WeightsBuilder, PathBuf)>,
    best: Option<Accuracy>,
    /// The best weights of an earlier run.
    earlier: Option<PathBuf>,
}

impl<'a> ProbeTask<'a> {
    fn new(
        recipe: &'a ProbeRecipe,
        (train, held_out): (&'a Latents, Option<&'a Latents>),
        things: Option<Things<'a>>,
        text_tower: Option<&Path>,
        run: &'a RunArgs,
    ) -> Result<Self> {
        recipe.validate()?;
        let own = &recipe.model;
        let episodes = Episodes::new(train, own.frame_skip, own.max_frames);
        episodes.require_successes()?;
        let most = Some(episodes.max_frames());
        let mut held_out = held_out
            .map(|held_out| Episodes::new(held_out, own.frame_skip, most))
            .filter(|held_out| held_out.len() > 0);
        if let Some([successes, failures]) = held_out.as_ref().map(Episodes::counts)
            && (successes == 0 || failures == 0)
        {
            println!(
                "validation has {successes} successes and {failures} failures: accuracy cannot be told, and the last weights \
                 are kept; give --held-out, a larger --validation, or another --validation-seed"
            );
        }
        let mut config = recipe.config(train.space(), episodes.max_frames());
        if let Some(old) = run.old_config::<ProbeNetworkConfig>(FILE, PROBE_KEY)? {
            config = recipe::resized(old, train.space(), config.max_frames());
        }
        let reads_instructions = config.text_features_mut().is_some();
        let negatives = match reads_instructions {
            true => recipe.negatives,
            false => Negatives::Any,
        };
        let episodes = episodes.with(negatives);
        episodes.require_negatives()?;
        held_out = held_out.map(|held_out| held_out.with(negatives));
        let mut fresh = run.fresh_weights(FILE, recipe.seed)?;
        let text = match (text_tower, config.text_features_mut()) {
            (Some(_), None) => {
                bail!("this kind of probe reads no instruction: leave --text-tower out")
            }
            (None, None) => {
                episodes.require_failures()?;
                Text::None
            }
            (Some(folder), Some(features)) => {
                let held_out = held_out.iter().flat_map(Episodes::instructions);
                let tower = Tower::read(folder, episodes.instructions().chain(held_out))?;
                *features = tower.features();
                Text::Tower(tower)
            }
            (None, Some(features)) => {
                let words = match old_words(run)? {
                    None => WordsConfig::of(episodes.instructions(), *features),
                    // The words of the old data stay known.
                    Some(old) => old.with(episodes.instructions()),
                };
                fresh.add_rows(WORD_FEATURES, words.vocabulary.len())?;
                fresh.add_rows(PLACE_FEATURES, words.max_words)?;
                if let Some(held_out) = &mut held_out {
                    leave_out_unknown(held_out, &words);
                }
                Text::words(&words, &fresh.loader())?
            }
        };
        let model = ProbeNetwork::load(&config, &fresh.loader())?;
        Ok(Self {
            model,
            text,
            recipe,
            train,
            episodes,
            held_out,
            things: things.filter(|_| matches!(config, ProbeNetworkConfig::Grounded(_))),
            config,
            variables: NetworkVariables::fresh(fresh, recipe, run)?,
            device: run.device()?,
            candidate: None,
            best: None,
            out: &run.out,
            earlier: None,
        })
    }

    fn loss(&self, rng: &mut ChaCha8Rng) -> Result<Tensor> {
        let recipe = self.recipe;
        let shares = if self.model.reads_instructions() {
            Shares {
                successes: recipe.successes,
                mismatches: recipe.mismatches,
                others: recipe.others,
            }
        } else {
            Shares::of_outcomes(recipe.successes)
        };
        let things = self.things.as_ref().filter(|_| recipe.pointing > 0.0);
        let pointing = things.map(|things| (things, recipe.pointing));
        let mut losses = Vec::with_capacity(recipe.micro_batch);
        for _ in 0..recipe.micro_batch {
            let sample = self.episodes.draw(shares, rng)?;
            let latents = &sample.latents;
            let noise = normals(latents.dims(), &Device::Cpu, rng)?;
            let latents = (latents + (noise * recipe.latent_noise)?)?;
            let [down, right] = [(); 2].map(|()| shift(recipe.shift, rng));
            let latents = shifted(&shifted(&latents, 2, down)?, 3, right)?;
            let sample = Sample {
                latents: latents.to_device(&self.device)?,
                shift: [down, right],
                ..sample
            };
            let questions = sample.questions.iter();
            let readings =
                questions.filter_map(|question| self.text.read(&question.instruction).transpose());
            let readings = readings.collect::<Result<Vec<_>>>()?;
            let mut dropout = Dropout::new(recipe.dropout, rng);
            losses.push(loss(
                &self.model,
                &sample,
                &readings,
                pointing,
                &mut dropout,
            )?);
        }
        Ok(Tensor::stack(&losses, 0)?.mean_all()?)
    }

    /// Accuracy of the last averaged weights.
    fn measure(&self, held_out: &Episodes<'_>) -> Result<Accuracy> {
        let (weights, _) = self.candidate.as_ref().context("nothing was written yet")?;
        let weights = Weights::from_bytes(FILE, weights.to_bytes())?;
        match &self.text {
            Text::Words(_) => {
                let reader = Reader::of_trained(&weights)?;
                accuracy(&weights, held_out, EPISODES, |text| {
                    Ok(Some(reader.read(text)?))
                })
            }
            Text::Tower(_) | Text::None => {
                accuracy(&weights, held_out, EPISODES, |text| self.text.read(text))
            }
        }
    }

    /// Writes the candidate with the figures that selected it.
    fn keep(&mut self, found: Option<Accuracy>) -> Result<()> {
        let Some((weights, path)) = &mut self.candidate else {
            return Ok(());
        };
        if let Some(found) = found {
            weights.metadata(VALIDATION_KEY, serde_json::to_string(&found)?);
        }
        Ok(weights.write(path)?)
    }
}

/// Vocabulary of the probe to fine-tune; `None` without one, or if it reads a text tower's features.
fn old_words(run: &RunArgs) -> Result<Option<WordsConfig>> {
    let old = run.old(FILE)?;
    let old = old.filter(|old| old.metadata(WORDS_KEY).is_some());
    Ok(old.map(|old| old.json(WORDS_KEY)).transpose()?)
}

/// A number of places between -`most` and `most`.
fn shift(most: usize, rng: &mut ChaCha8Rng) -> i64 {
    let most = most as i64;
    rng.random_range(-most..=most)
}

/// Shifts along `dim` by `by` places; the border is repeated.
fn shifted(latents: &Tensor, dim: usize, by: i64) -> Result<Tensor> {
    if by == 0 {
        return Ok(latents.clone());
    }
    let last = latents.dim(dim)? as i64 - 1;
    let from = (0..=last).map(|place| (place - by).clamp(0, last) as u32);
    let from = Tensor::from_iter(from, latents.device())?;
    Ok(latents.contiguous()?.index_select(&from, dim)?)
}

/// Excludes episodes with unknown words in their instruction, and logs them.
fn leave_out_unknown(episodes: &mut Episodes<'_>, words: &WordsConfig) {
    let unknown = episodes.leave_out(|instruction| words.encode(instruction).is_err());
    if !unknown.is_empty() {
        let unknown = unknown.join("; ");
        println!(
            "excluded from the measurement, since the probe does not know their words: {unknown}"
        );
    }
}

/// Accuracy of a probe's weights; `read` reads instructions, if the probe needs them.
fn accuracy(
    weights: &Weights,
    episodes: &Episodes<'_>,
    most: usize,
    read: impl Fn(&str) -> Result<Option<Reading>>,
) -> Result<Accuracy> {
    let supply = OfWeights(weights);
    let loader = Loader::supplied(&supply, Kernels::Cpu);
    let probe = ProbeNetwork::load(&weights.json(PROBE_KEY)?, &loader)?;
    let samples: Vec<Sample> = episodes.all(most).collect::<Result<_>>()?;
    // Each is read once: a text tower takes a second.
    let mut readings = BTreeMap::new();
    for question in samples.iter().flat_map(|sample| &sample.questions) {
        if let Entry::Vacant(entry) = readings.entry(&*question.instruction) {
            entry.insert(read(&question.instruction)?);
        }
    }
    let answer = |sample: &Sample| {
        let questions = sample.questions.iter();
        // A probe without instructions cannot reject another episode's.
        let questions =
            questions.filter(|question| probe.reads_instructions() || !question.is_mismatch);
        let answers = questions.map(|question| {
            let reading = readings.get(&*question.instruction);
            let reading = reading.context("an instruction was not read")?;
            let logit = probe.forward(&sample.latents, reading.as_ref())?;
            Ok((logit.squeeze(0)?.to_scalar::<f32>()?, question.clone()))
        });
        answers.collect::<Result<Vec<_>>>()
    };
    let answers = samples.par_iter().map(answer).collect::<Result<Vec<_>>>()?;
    let (mut own, mut mismatched) = (Vec::new(), Vec::new());
    for (logit, question) in answers.into_iter().flatten() {
        if question.is_mismatch {
            mismatched.push(logit);
        } else {
            own.push((logit, question.answer));
        }
    }
    Ok(Accuracy::of(&own, &mismatched))
}

impl NetworkLearner for ProbeTask<'_> {
    fn variables(&self) -> &NetworkVariables {
        &self.variables
    }

    fn batch_loss(&self, _step: u64, rng: &mut ChaCha8Rng) -> Result<BatchLoss> {
        Ok(BatchLoss::from(self.loss(rng)?))
    }
}

impl Task for ProbeTask<'_> {
    fn name(&self) -> &'static str {
        "probe"
    }

    fn files(&self) -> &'static [&'static str] {
        &[FILE]
    }

    fn resumed(&mut self) {
        self.earlier = Some(self.out.join(FILE));
    }

    fn write(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
        folder: &Path,
    ) -> Result<()> {
        let config = (PROBE_KEY, &self.config);
        let mut weights = trained_weights(averaged, config, Some(self.train.space()))?;
        self.text.describe(&mut weights)?;
        weights.metadata(FRAME_SKIP_KEY, self.recipe.model.frame_skip.to_string());
        let path = folder.join(FILE);
        let is_there = path.is_file();
        self.candidate = Some((weights, path));
        // The validation decides, if any.
        if self.held_out.is_none() || !is_there {
            self.keep(None)?;
        }
        Ok(())
    }

    fn validate(&mut self, _thorough: bool) -> Result<Vec<Figure>> {
        let Some(held_out) = &self.held_out else {
            return Ok(Vec::new());
        };
        let found = self.measure(held_out)?;
        if let Some(path) = self.earlier.take()
            && path.is_file()
        {
            // It has none if the earlier run ended before its first validation.
            self.best = Weights::open(&path)?.json(VALIDATION_KEY).ok();
        }
        if self.best.is_none_or(|best| found.is_better_than(&best)) {
            self.keep(Some(found))?;
            self.best = Some(found);
        }
        Ok(found.figures())
    }
}

#[cfg(test)]
mod parity;
#[cfg(test)]
mod tests;
