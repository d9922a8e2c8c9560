//! The command-line arguments that every training has.

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
    recipe::{Override, Recipe, Span},
    run::{Ended, RunSettings, Stop, Task},
};

/// Data, folder and recipe of a training.
#[derive(Clone, Debug, Args)]
pub struct RunArgs {
    /// What to train on: bags, folders of bags, or folders that `wm dataset` prepared.
    #[arg(long, visible_alias = "bags", required = true, num_args = 1.., value_name = "PATH")]
    pub data: Vec<PathBuf>,
    /// How recordings become episodes, and which are for validation.
    #[command(flatten)]
    pub options: DataOptions,
    /// Folder of the model: weights, recipe, checkpoint, journal, loss curve and samples. A training that was
    /// interrupted resumes from here. Several trainings may share a folder.
    #[arg(long)]
    pub out: PathBuf,
    /// Folder for decoded frames and latents; `cache` in the output folder by default.
    #[arg(long)]
    pub cache: Option<PathBuf>,
    /// Recipe: tiny, paper (where the paper has this training), or a YAML file.
    #[arg(long, default_value = "tiny")]
    pub recipe: String,
    /// A setting of the recipe, as optimisation.learning_rate=1e-3; may be repeated.
    #[arg(long, value_name = "PATH=VALUE")]
    pub set: Vec<Override>,
    /// Optimiser steps, instead of the recipe's length.
    #[arg(long)]
    pub steps: Option<u64>,
    /// Fine-tune this model (tiny, or a model's folder) instead of beginning anew: sizes and conventions are then its, not
    /// the recipe's. What does not fit the new data, as the embedding of other actions, begins anew.
    #[arg(long, value_name = "MODEL")]
    pub from: Option<String>,
    /// Learning rate of what is taken from that model, as a fraction of the recipe's.
    #[arg(long, default_value_t = 0.3, value_name = "FRACTION", value_parser = fraction)]
    pub old_rate: f64,
    /// Train for this fraction of the recipe's length.
    #[arg(long, default_value_t = 1.0, value_name = "FRACTION", value_parser = fraction)]
    pub share: f64,
    /// Number of threads; all of the machine by default. On a GPU, the parts of a batch that are computed side by side: 1
    /// by default.
    #[arg(long)]
    pub threads: Option<usize>,
    /// Where to compute: cpu, cuda or cuda:N. A GPU needs the cargo feature `cuda`.
    #[arg(long, default_value = "cpu")]
    pub device: Compute,
    /// Number format of the weights while they are multiplied: f32 or bf16, for the transition model and its distillation
    /// on a GPU. The optimiser keeps them in f32.
    #[arg(long, default_value = "f32", value_parser = dtype)]
    pub dtype: NumberFormat,
}

/// Data with their latents.
#[derive(Debug)]
pub struct Encoded {
    /// The frames.
    pub data: Data,
    /// The latents to train on.
    pub train: Latents,
    /// Those for validation, if there are any.
    pub held_out: Option<Latents>,
}

impl RunArgs {
    /// The data, with frames as `framing` says, all cameras side by side.
    ///
    /// # Errors
    /// Names what cannot be used.
    pub fn data(&self, framing: impl Into<Framing>) -> Result<Data, DatasetError> {
        Data::open(&self.data, framing, &self.cache(), &self.options)
    }

    /// The data and their latents.
    ///
    /// # Errors
    /// If the data cannot be used, or a frame cannot be encoded.
    pub fn encoded(&self, encoder: &dyn Encoder) -> Result<Encoded> {
        let data = self.data(encoder.framing())?;
        let cache = self.cache();
        let validation = data.validation.as_ref();
        Ok(Encoded {
            train: Latents::open(&data.training, encoder, &cache)?,
            held_out: validation
                .map(|data| Latents::open(data, encoder, &cache))
                .transpose()?,
            data,
        })
    }

    /// The groups of the optimiser: what begins anew, and what was taken from another model.
    #[must_use]
    pub fn groups(&self) -> Vec<Group> {
        vec![
            Group::default(),
            Group {
                rate: self.old_rate,
            },
        ]
    }

    /// What the training of a network begins from, whose weights are `file` in a model's folder.
    ///
    /// # Errors
    /// If the model to fine-tune has no such file, or it cannot be read.
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
            "--dtype bf16 is for the transition model and its distillation; this training takes f32"
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

    /// The configuration of the network to fine-tune, under `key` of its metadata; `None` without one.
    ///
    /// # Errors
    /// If the model to fine-tune has no such file, or it cannot be read.
    pub fn old_config<C: DeserializeOwned>(&self, file: &str, key: &str) -> Result<Option<C>> {
        Ok(match self.old(file)? {
            None => None,
            Some(old) => Some(old.json(key)?),
        })
    }

    fn old(&self, file: &str) -> Result<Option<Weights>> {
        let Some(from) = &self.from else {
            return Ok(None);
        };
        let old = ModelFolder::open(from)?.weights(file)?;
        old.map(Some)
            .with_context(|| format!("--from {from}: it has no {file}"))
    }

    /// What of these arguments decides the result, for the identity of a run.
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

    /// The settings that are overridden, in the order in which they apply.
    #[must_use]
    pub fn overrides(&self) -> Vec<Override> {
        let mut overrides = self.set.clone();
        overrides.extend(
            self.steps
                .map(|steps| Override::new("length", format!("{steps} steps"))),
        );
        overrides
    }

    /// The steps of a training of this length, of which an epoch has `per_epoch`; at least one.
    #[must_use]
    pub fn length(&self, length: Span, per_epoch: f64) -> u64 {
        let steps = length.steps(per_epoch) as f64 * self.share;
        (steps.ceil() as u64).max(1)
    }

    /// How to run a training by `recipe`, of which an epoch has `samples`. `data` is what decides the result besides the
    /// recipe and the model to begin from.
    ///
    /// # Errors
    /// If the recipe cannot be told in JSON.
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

    /// Trains `task`: writes the resolved recipe beside the weights, says what it trains on, and in the end what it wrote.
    ///
    /// # Errors
    /// As [`crate::run::train`].
    pub fn train(
        &self,
        task: &mut dyn Task,
        recipe: &impl Recipe,
        settings: &RunSettings,
        (about, stop): (&str, &Stop),
    ) -> Result<Ended> {
        crate::recipe::write(&self.out, task.name(), recipe)?;
        println!("{about}");
        let ended = crate::run::train(task, settings, stop)?;
        if ended == Ended::Finished {
            // What a student is called is decided after its training.
            let files = task.files().iter().map(|file| self.out.join(file));
            for path in files.filter(|path| path.exists()) {
                println!("wrote {}", path.display());
            }
        }
        Ok(ended)
    }

    /// Where decoded frames and latents are kept.
    #[must_use]
    pub fn cache(&self) -> PathBuf {
        self.cache.clone().unwrap_or_else(|| self.out.join("cache"))
    }

    /// Number of threads.
    ///
    /// # Errors
    /// If the system does not tell how many there are.
    pub fn threads(&self) -> Result<usize> {
        match (self.threads, self.device.is_cpu()) {
            (Some(threads), _) => Ok(threads),
            (None, false) => Ok(1),
            (None, true) => Ok(std::thread::available_parallelism()
                .context("how many threads there are")?
                .get()),
        }
    }

    /// The name that a model of one's own gets: that of its folder.
    #[must_use]
    pub fn model_name(&self) -> String {
        let name = std::path::absolute(&self.out).ok();
        let name = name.as_deref().and_then(|path| path.file_name());
        name.map_or("model".into(), |name| name.to_string_lossy().into_owned())
    }
}

fn dtype(name: &str) -> Result<NumberFormat, String> {
    match name {
        "f32" => Ok(NumberFormat::F32),
        "bf16" => Ok(NumberFormat::Bf16),
        _ => Err("expected f32 or bf16".to_owned()),
    }
}

/// A positive number.
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

    /// A run of two threads in `out`, whose data the test gives.
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
