//! Command-line arguments of every training.

mod latents;
mod pictures;

use std::{path::PathBuf, time::Duration};

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use candle_core::Device;
use wm_dataset::{Data, DataOptions, DatasetError, Latents};
use wm_model::{Compute, Encoder, Framing, Kernels, NumberFormat, Weights};
use wm_zoo::ModelFolder;

use crate::{
    fresh_weights::FreshWeights,
    optimiser::Group,
    recipe::{Override, Recipe, RecipeError, Span},
    run::{RunEnd, RunSettings, Stop, Task},
};

pub use latents::{HeldOutLatentArgs, LatentRunArgs};
pub use pictures::PictureRunArgs;

/// Data, folder and recipe of a training.
#[derive(Clone, Debug, Args)]
pub struct RunArgs {
    /// Data to train on: bags, folders of bags, or folders prepared by `wm dataset`
    #[arg(long, visible_alias = "bags", required = true, num_args = 1.., value_name = "PATH")]
    pub data: Vec<PathBuf>,
    /// Options of the data.
    #[command(flatten)]
    pub options: DataOptions,
    /// Folder of the model: weights, recipe, checkpoint, journal, loss curve and samples. An interrupted training
    /// resumes from here; several trainings may share a folder
    #[arg(long)]
    pub out: PathBuf,
    /// Folder for decoded frames and latents [default: `cache` in the output folder]
    #[arg(long)]
    pub cache: Option<PathBuf>,
    /// Recipe: tiny, paper (if the paper has this training), or a YAML file
    #[arg(long, default_value = "tiny")]
    pub recipe: String,
    /// Setting of the recipe, such as optimisation.learning_rate=1e-3 (repeatable)
    #[arg(long, value_name = "PATH=VALUE")]
    pub set: Vec<Override>,
    /// Optimiser steps, instead of the recipe's length
    #[arg(long)]
    pub steps: Option<u64>,
    /// Model to fine-tune (tiny, or a model's folder): it determines sizes and conventions instead of the recipe. Parts
    /// that do not fit the new data, such as the embedding of other actions, start anew
    #[arg(long, value_name = "MODEL")]
    pub from: Option<String>,
    /// Learning rate of the fine-tuned weights, as a fraction of the recipe's
    #[arg(long, default_value_t = 0.3, value_name = "FRACTION", value_parser = fraction)]
    pub old_rate: f64,
    /// Fraction of the recipe's length to train
    #[arg(long, default_value_t = 1.0, value_name = "FRACTION", value_parser = fraction)]
    pub share: f64,
    /// Number of threads [default: all of the machine]. On a GPU, the parts of a batch computed in parallel [default:
    /// 1]
    #[arg(long)]
    pub threads: Option<usize>,
    /// Device: cpu, cuda or cuda:N; a GPU needs the cargo feature `cuda`
    #[arg(long, default_value = "cpu")]
    pub device: Compute,
    /// Number format of the weights in products: f32 or bf16, for the transition model and its distillation on a GPU.
    /// The optimiser keeps f32
    #[arg(long, default_value = "f32", value_parser = dtype)]
    pub dtype: NumberFormat,
}

/// Data with their latents.
#[derive(Debug)]
pub struct EncodedData {
    /// The frames.
    pub data: Data,
    /// Latents for training.
    pub train: Latents,
    /// Latents for validation, if any.
    pub held_out: Option<Latents>,
}

impl RunArgs {
    /// Opens the data with frames of `framing`, all cameras side by side.
    ///
    /// # Errors
    /// Names the unusable file or option.
    pub fn data(&self, framing: impl Into<Framing>) -> Result<Data, DatasetError> {
        Data::open(&self.data, framing, &self.cache(), &self.options)
    }

    /// Opens the data with their latents.
    ///
    /// # Errors
    /// If the data are unusable, or a frame cannot be encoded.
    pub fn encoded(&self, encoder: &dyn Encoder) -> Result<EncodedData> {
        let data = self.data(encoder.framing())?;
        let cache = self.cache();
        let validation = data.validation.as_ref();
        Ok(EncodedData {
            train: Latents::open(&data.training, encoder, &cache)?,
            held_out: validation
                .map(|data| Latents::open(data, encoder, &cache))
                .transpose()?,
            data,
        })
    }

    /// Groups of the optimiser: new weights, and fine-tuned ones.
    #[must_use]
    pub fn groups(&self) -> Vec<Group> {
        vec![
            Group::default(),
            Group {
                rate: self.old_rate,
            },
        ]
    }

    /// Initial weights of a network, whose file in a model's folder is `file`.
    ///
    /// # Errors
    /// If the model to fine-tune lacks the file, or it cannot be read.
    pub fn fresh_weights(&self, file: &str, seed: u64) -> Result<FreshWeights> {
        let fresh = match self.old(file)? {
            None => FreshWeights::new(seed),
            Some(old) => FreshWeights::tuning_weights(seed, &old)?,
        };
        Ok(fresh.on(&self.compute_f32()?)?)
    }

    /// Where and in which number format to compute.
    ///
    /// # Errors
    /// If there is no such device.
    pub fn compute(&self) -> Result<Compute> {
        let compute = self.device.clone().with_kernels(Kernels::Candle)?;
        let compute = compute.with_format(self.dtype)?;
        compute.device()?;
        Ok(compute)
    }

    /// The same, for a training that knows f32 only.
    ///
    /// # Errors
    /// If there is no such device, or another number format is asked for.
    pub fn compute_f32(&self) -> Result<Compute> {
        ensure!(
            self.dtype == NumberFormat::F32,
            "--dtype bf16 applies only to the transition model and its distillation; use f32"
        );
        self.compute()
    }

    /// Where to compute.
    ///
    /// # Errors
    /// If there is no such device.
    pub fn device(&self) -> Result<Device> {
        Ok(self.device.device()?.clone())
    }

    /// Configuration of the network to fine-tune, under `key` of its metadata; `None` without one.
    ///
    /// # Errors
    /// If the model to fine-tune lacks the file, or it cannot be read.
    pub fn old_config<C: DeserializeOwned>(&self, file: &str, key: &str) -> Result<Option<C>> {
        Ok(match self.old(file)? {
            None => None,
            Some(old) => Some(old.json(key)?),
        })
    }

    /// Weights of the network to fine-tune; `None` without one.
    ///
    /// # Errors
    /// If the model to fine-tune lacks the file, or it cannot be read.
    pub fn old(&self, file: &str) -> Result<Option<Weights>> {
        let Some(from) = &self.from else {
            return Ok(None);
        };
        let old = ModelFolder::open(from)?.weights(file)?;
        old.map(Some)
            .with_context(|| format!("--from {from}: it has no {file}"))
    }

    /// The arguments that affect the result, for the identity of a run.
    #[must_use]
    pub fn origin(&self) -> Value {
        let mut origin = serde_json::Map::new();
        if let Some(from) = &self.from {
            origin.insert("from".into(), json!(from));
            origin.insert("old_rate".into(), json!(self.old_rate));
        }
        if self.dtype != NumberFormat::F32 {
            origin.insert("dtype".into(), json!(self.dtype));
        }
        match origin.is_empty() {
            true => Value::Null,
            false => Value::Object(origin),
        }
    }

    /// Overridden settings in the order of application.
    #[must_use]
    pub fn overrides(&self) -> Vec<Override> {
        let mut overrides = self.set.clone();
        overrides.extend(
            self.steps
                .map(|steps| Override::new("length", format!("{steps} steps"))),
        );
        overrides
    }

    /// The recipe with overridden settings, and `further` ones.
    ///
    /// # Errors
    /// Names an invalid setting.
    pub fn load_recipe<R: Recipe>(
        &self,
        further: impl IntoIterator<Item = Override>,
    ) -> Result<R, RecipeError> {
        let overrides: Vec<Override> = self.overrides().into_iter().chain(further).collect();
        crate::recipe::load(R::BUNDLED, &self.recipe, &overrides)
    }

    /// Steps of a training of this length, with `per_epoch` steps per epoch; at least one.
    #[must_use]
    pub fn length(&self, length: Span, per_epoch: f64) -> u64 {
        let steps = length.steps(per_epoch) as f64 * self.share;
        (steps.ceil() as u64).max(1)
    }

    /// Settings of a training by `recipe` with `samples` samples per epoch. `data` describes further inputs that affect
    /// the result.
    ///
    /// # Errors
    /// If the recipe cannot be written as JSON.
    pub fn settings(
        &self,
        recipe: &impl Recipe,
        samples: usize,
        data: impl IntoIterator<Item = (&'static str, Value)>,
    ) -> Result<RunSettings> {
        let course = recipe.course();
        let per_epoch = course.per_epoch(samples);
        let steps = self.length(course.length, per_epoch);
        let recipe = ("recipe", crate::recipe::identity(recipe)?);
        let identity = data.into_iter().chain([recipe, ("from", self.origin())]);
        Ok(RunSettings {
            out: self.out.clone(),
            steps,
            schedule: course.optimisation.schedule(steps, per_epoch),
            optimiser: course.optimisation.adamw(),
            checkpoint_every: Duration::from_secs(course.checkpoint_seconds),
            validate_every: course.validate_every,
            identity: identity
                .map(|(key, value)| (key.to_owned(), value))
                .collect(),
        })
    }

    /// Trains `task`: writes the resolved recipe beside the weights, and prints the data and the written files.
    ///
    /// # Errors
    /// Those of [`crate::run::train`].
    pub fn train(
        &self,
        task: &mut dyn Task,
        recipe: &impl Recipe,
        settings: &RunSettings,
        (about, stop): (&str, &Stop),
    ) -> Result<RunEnd> {
        crate::recipe::write(&self.out, task.name(), recipe)?;
        println!("{about}");
        let ended = crate::run::train(task, settings, stop)?;
        if ended == RunEnd::Finished {
            // The name of a student depends on its training.
            let files = task.files().iter().map(|file| self.out.join(file));
            for path in files.filter(|path| path.exists()) {
                println!("wrote {}", path.display());
            }
        }
        Ok(ended)
    }

    /// Trains `task` on the clips of `episodes`.
    ///
    /// # Errors
    /// Those of [`crate::run::train`].
    pub(crate) fn train_on_clips(
        &self,
        task: &mut dyn Task,
        recipe: &impl Recipe,
        (episodes, data): (usize, impl IntoIterator<Item = (&'static str, Value)>),
        stop: &Stop,
    ) -> Result<RunEnd> {
        let settings = self.settings(recipe, episodes, data)?;
        let about = format!("{episodes} episodes, {} threads", self.threads()?);
        self.train(task, recipe, &settings, (&about, stop))
    }

    /// Folder for decoded frames and latents.
    #[must_use]
    pub fn cache(&self) -> PathBuf {
        self.cache.clone().unwrap_or_else(|| self.out.join("cache"))
    }

    /// Number of threads.
    ///
    /// # Errors
    /// If the system does not report it.
    pub fn threads(&self) -> Result<usize> {
        match (self.threads, self.device.is_cpu()) {
            (None, false) => Ok(1),
            (given, _) => threads(given),
        }
    }

    /// Name of the trained model: that of its folder.
    #[must_use]
    pub fn model_name(&self) -> String {
        let name = std::path::absolute(&self.out).ok();
        let name = name.as_deref().and_then(|path| path.file_name());
        name.map_or("model".into(), |name| name.to_string_lossy().into_owned())
    }
}

/// The given number of threads, or one for each processor.
pub(crate) fn threads(given: Option<usize>) -> Result<usize> {
    match given {
        Some(threads) => Ok(threads),
        None => Ok(std::thread::available_parallelism()
            .context("number of threads")?
            .get()),
    }
}

fn dtype(name: &str) -> Result<NumberFormat, String> {
    match name {
        "f32" => Ok(NumberFormat::F32),
        "bf16" => Ok(NumberFormat::Bf16),
        _ => Err("expected f32 or bf16".to_owned()),
    }
}

/// Parses a positive number.
pub(crate) fn fraction(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if f64::is_finite(value) && value > 0.0 => Ok(value),
        _ => Err("expected a positive number".to_owned()),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::path::Path;

    use super::*;

    /// A run with two threads in `out`; the test supplies the data.
    pub(crate) fn run_in(out: &Path) -> RunArgs {
        RunArgs {
            data: Vec::new(),
            options: DataOptions::default(),
            out: out.into(),
            cache: None,
            recipe: "tiny".into(),
            set: Vec::new(),
            steps: None,
            share: 1.0,
            from: None,
            old_rate: 0.3,
            threads: Some(2),
            device: Compute::default(),
            dtype: NumberFormat::F32,
        }
    }

    pub(crate) fn on_cpu() -> Compute {
        Compute::on_cpu(Kernels::Candle)
    }
}
