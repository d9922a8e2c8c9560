//! A round of the learner: trains a new model from the present one on recordings, and tests both on the newest
//! recordings, on which neither was trained.
//!
//! Each round has a folder in the folder of models, `round-NNNN`: the new model, [`PLAN`] with what it is trained and
//! tested on, and [`RESULT`] once it is finished. A killed round resumes.

mod plan;
mod verdict;

use std::{
    fs::File,
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::{Context as _, Result, bail, ensure};
use clap::Args;
use rustix::{fs::FlockOperation, process::Signal};
use serde::{Deserialize, Serialize};
use wm_dataset::{DataOptions, Dataset};
use wm_model::{Autoencoder, Compute, Fit, Framing, NumberFormat};
use wm_zoo::{IDM_FILE, ModelFolder};

use crate::{
    arguments::{LatentRunArgs, PictureRunArgs, RunArgs, fraction},
    autoencoder::{TrainAutoencoderArgs, evaluate},
    idm::TrainIdmArgs,
    recipe::Override,
    run::{RunEnd, Stop, checkpoint},
    transition::{ListenArgs, TrainTransitionArgs},
};
pub use plan::Plan;
use verdict::Verdict;

/// The file with the recordings of a round, in its folder.
pub const PLAN: &str = "round.json";
/// The file with the result of a round, in its folder.
pub const RESULT: &str = "result.json";
/// Time between checkpoints, with which the journal and so the learner's progress are written \[s\]. A killed round loses
/// at most this much.
const CHECKPOINT_SECONDS: u64 = 30;
/// Frames on which the autoencoder is measured.
const MEASURED: usize = 64;
/// Learning rate of weights that were already trained in this latent space, as a fraction of the recipe's.
const CONTINUED_RATE: f64 = 0.5;
/// Fraction of the transition model's steps in which the learning rate rises.
const WARM_UP: f64 = 0.1;

/// Train a new model from the present one on recordings, and test both on the newest recordings. The node learner runs this
#[derive(Clone, Debug, Args)]
pub struct TrainRoundArgs {
    /// Folder with bags, whose names sort by age; the newest ones are for the test
    #[arg(long, value_name = "DIR")]
    pub recordings: PathBuf,
    /// Options of the data.
    #[command(flatten)]
    pub options: DataOptions,
    /// Folder for the models
    #[arg(long, value_name = "DIR")]
    pub models: PathBuf,
    /// The present model: tiny, or a model's folder
    #[arg(long, value_name = "MODEL")]
    pub from: String,
    /// Train the autoencoder first if the PSNR of the present one's pictures is below this, in dB
    #[arg(long, default_value_t = 25.0, value_name = "DB")]
    pub least_psnr: f64,
    /// Duration of a round without the autoencoder's training, which each round approaches by the duration of the one
    /// before, in seconds
    #[arg(long, default_value_t = 240.0, value_name = "SECONDS", value_parser = fraction)]
    pub seconds: f64,
    /// Optimiser steps of the autoencoder
    #[arg(long, default_value_t = 200, value_name = "STEPS")]
    pub autoencoder_steps: u64,
    /// Most optimiser steps of the transition model in a round
    #[arg(long, default_value_t = 1200, value_name = "STEPS")]
    pub transition_steps: u64,
    /// Most optimiser steps of the inverse dynamics model in a round; 0: none
    #[arg(long, default_value_t = 200, value_name = "STEPS")]
    pub idm_steps: u64,
    /// Most bags to train on: half of them the newest, the others drawn from all
    #[arg(long, default_value_t = 40, value_name = "BAGS")]
    pub most_bags: usize,
    /// Newest bags that are for the test alone
    #[arg(long, default_value_t = 2, value_name = "BAGS")]
    pub test_bags: usize,
    /// How pictures of another aspect fit the model: crop (the middle), stretch or pad (black bars) [default: as the
    /// present model's]
    #[arg(long, value_name = "FIT")]
    pub fit: Option<Fit>,
    /// Setting of a part's recipe, such as transition.model.frame_skip=3 (repeatable)
    #[arg(long, value_name = "PART.PATH=VALUE")]
    pub set: Vec<Override>,
    /// Number of threads [default: one for each processor]
    #[arg(long)]
    pub threads: Option<usize>,
    /// Added to the nice value, as with nice(1)
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub nice: i32,
    /// Processors to run on, as numbers of Linux [default: all]
    #[arg(long, value_delimiter = ',', value_name = "CPU")]
    pub processors: Vec<usize>,
}

/// How a round ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RoundResult {
    /// Its number, from 1.
    pub round: u32,
    /// Duration of the data that it trained on \[s\].
    pub trained_on: f64,
    /// Duration of the data that it was tested on \[s\].
    pub tested_on: f64,
    /// Duration of the round, without the training of an autoencoder \[s\]; `None` for a round that was interrupted.
    pub lasted: Option<f64>,
    /// The comparison of the new model with the present one.
    pub verdict: Verdict,
    /// Folder of the new model.
    pub model: PathBuf,
}

impl TrainRoundArgs {
    /// Trains and tests, or trains until `stop` is set. Prints the result as a line of JSON.
    ///
    /// # Errors
    /// If there are too few recordings, or a part cannot be trained.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        self.yield_to_others()?;
        // The node that started this may be killed. Then the round is saved.
        rustix::process::set_parent_process_death_signal(Some(Signal::TERM))?;
        let _alone = lock(&self.models)?;
        let plan = Plan::of(self)?;
        let ended = self.train(&plan, stop);
        if ended.is_err() {
            // The next round takes other recordings: with these ones it would fail again.
            let folder = plan.folder(&self.models);
            std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?;
        }
        ended
    }

    fn train(&self, plan: &Plan, stop: &Stop) -> Result<RunEnd> {
        let folder = plan.folder(&self.models);
        let own = folder.display().to_string();
        let test = self.unsplit_options();
        let present = ModelFolder::open(&self.from)?;
        let has_encoder = self.encodes_well(&present, plan, &test)?;
        let encoder = match has_encoder {
            true => self.from.clone(),
            false => own.clone(),
        };
        let on = |run| LatentRunArgs {
            run,
            encoder: encoder.clone(),
        };
        if !has_encoder {
            let run = self.of("autoencoder", plan, self.autoencoder_steps, 1.0)?;
            let fit = Some(self.fit.map_or_else(|| present.fit(), Ok)?);
            let on = PictureRunArgs { run, fit };
            if (TrainAutoencoderArgs { on }).run(stop)? == RunEnd::Stopped {
                return Ok(RunEnd::Stopped);
            }
        }
        let began = match checkpoint(&folder, "transition").is_file() {
            true => None,
            false => Some(Instant::now()),
        };
        let rate = if has_encoder { CONTINUED_RATE } else { 1.0 };
        let run = self.of("transition", plan, plan.transition_steps, rate)?;
        let transition = TrainTransitionArgs {
            on: on(run),
            listen: ListenArgs::default(),
        };
        if transition.run(stop)? == RunEnd::Stopped {
            return Ok(RunEnd::Stopped);
        }
        if plan.idm_steps > 0 {
            let run = self.of("idm", plan, plan.idm_steps, rate)?;
            if (TrainIdmArgs { on: on(run) }).run(stop)? == RunEnd::Stopped {
                return Ok(RunEnd::Stopped);
            }
        }
        let cache = self.models.join(CACHE);
        let verdict = Verdict::of(&own, &self.from, &plan.test, &test, &cache)?;
        let result = RoundResult {
            round: plan.round,
            trained_on: plan.train_s,
            tested_on: plan.test_s,
            lasted: began.map(|began| began.elapsed().as_secs_f64()),
            verdict,
            model: folder.clone(),
        };
        let text = serde_json::to_string(&result)?;
        write_whole(&folder.join(RESULT), &text)?;
        let framing = ModelFolder::open(&own)?.framing()?;
        if let Err(error) = self.trim_cache(plan, framing) {
            tracing::warn!("the cache keeps what no round needs: {error:#}");
        }
        // What a finished round does not need.
        let is_better = verdict.is_better;
        remove(&folder, |name| {
            name.ends_with(".checkpoint.safetensors")
                || !is_better && name.ends_with(".safetensors")
        })?;
        println!("{text}");
        Ok(RunEnd::Finished)
    }

    /// Removes decoded frames and latents of recordings that this round did not use: later rounds use mostly the same ones.
    fn trim_cache(&self, plan: &Plan, framing: Framing) -> Result<()> {
        let cache = self.models.join(CACHE);
        let options = self.unsplit_options();
        let bags: Vec<PathBuf> = plan.train.iter().chain(&plan.test).cloned().collect();
        let used = Dataset::held_out(&bags, framing, &cache, &options)?;
        for entry in std::fs::read_dir(&cache).with_context(|| cache.display().to_string())? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if used.is_cached_as(&name) {
                continue;
            }
            let removed = match path.is_dir() {
                true => std::fs::remove_dir_all(&path),
                false => std::fs::remove_file(&path),
            };
            removed.with_context(|| path.display().to_string())?;
        }
        Ok(())
    }

    /// Sets priority and processors. Threads inherit them, so this comes first.
    fn yield_to_others(&self) -> Result<()> {
        if self.nice != 0 {
            rustix::process::nice(self.nice).context("--nice")?;
        }
        if !self.processors.is_empty() {
            let mut set = rustix::thread::CpuSet::new();
            for processor in &self.processors {
                ensure!(
                    *processor < rustix::thread::CpuSet::MAX_CPU,
                    "--processors {processor}: expected at most {}",
                    rustix::thread::CpuSet::MAX_CPU - 1
                );
                set.set(*processor);
            }
            rustix::thread::sched_setaffinity(None, &set).context("--processors")?;
        }
        Ok(())
    }

    /// Whether the present model's autoencoder reconstructs the new pictures well. The decision of a resumed round stays.
    fn encodes_well(&self, present: &ModelFolder, plan: &Plan, test: &DataOptions) -> Result<bool> {
        let folder = plan.folder(&self.models);
        if folder.join("autoencoder.checkpoint.safetensors").is_file() {
            return Ok(false);
        }
        let has_other_fit = |fit: Fit| -> Result<bool> { Ok(present.fit()? != fit) };
        if self.fit.map_or(Ok(false), has_other_fit)? {
            return Ok(false);
        }
        let Some(trained) = present.trained() else {
            // An encoder that this program cannot train.
            return Ok(true);
        };
        let autoencoder: Autoencoder = trained.autoencoder()?;
        let cache = self.models.join(CACHE);
        let data = Dataset::held_out(&plan.test, present.framing()?, &cache, test)?;
        let found = evaluate(&autoencoder, &data, MEASURED)?;
        tracing::info!("the pictures of {}: {found}", self.from);
        Ok(found.psnr >= self.least_psnr)
    }

    /// The options of the data without a split.
    fn unsplit_options(&self) -> DataOptions {
        DataOptions {
            held_out: Vec::new(),
            by_bag: true,
            ..self.options.clone()
        }
    }

    fn of(&self, part: &str, plan: &Plan, steps: u64, old_rate: f64) -> Result<RunArgs> {
        ensure!(steps > 0, "0 steps of the {part}, expected at least 1");
        let mut set = vec![Override::new("checkpoint_seconds", CHECKPOINT_SECONDS)];
        if part == "transition" {
            let warm_up = (steps as f64 * WARM_UP).ceil();
            set.extend([
                Override::new("batch", plan.clips),
                Override::new("micro_batch", 1),
                Override::new("optimisation.warm_up", format!("{warm_up} steps")),
            ]);
        }
        // The user's settings come last, and win.
        let own = self.set.iter().filter(|setting| setting.part() == part);
        set.extend(own.map(Override::of_part));
        let folder = plan.folder(&self.models);
        let present = ModelFolder::open(&self.from)?;
        let has_part = part != "idm" || present.weights(IDM_FILE)?.is_some();
        Ok(RunArgs {
            data: plan.train.clone(),
            // The test at the end is the only validation.
            options: DataOptions {
                validation: Some(0.0),
                ..self.unsplit_options()
            },
            cache: Some(self.models.join(CACHE)),
            out: folder,
            recipe: "tiny".to_owned(),
            set,
            steps: Some(steps),
            share: 1.0,
            from: has_part.then(|| self.from.clone()),
            old_rate,
            threads: self.threads,
            device: Compute::default(),
            dtype: NumberFormat::F32,
        })
    }
}

/// Folder of decoded frames and latents beside the rounds' folders, which share it.
const CACHE: &str = "cache";

/// Waits until no other process trains in the folder, for example one that is saving.
fn lock(models: &Path) -> Result<File> {
    std::fs::create_dir_all(models).with_context(|| models.display().to_string())?;
    let path = models.join("lock");
    let file = File::create(&path).with_context(|| path.display().to_string())?;
    rustix::fs::flock(&file, FlockOperation::LockExclusive)
        .with_context(|| path.display().to_string())?;
    Ok(file)
}

/// Removes the files in a folder whose names are `unneeded`.
fn remove(folder: &Path, unneeded: impl Fn(&str) -> bool) -> Result<()> {
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        if path
            .file_name()
            .and_then(|name| name.to_str())
            .is_some_and(&unneeded)
        {
            std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
        }
    }
    Ok(())
}

/// Writes a file whole or not at all.
fn write_whole(path: &Path, text: &str) -> Result<()> {
    let part = path.with_extension("part");
    std::fs::write(&part, text).with_context(|| part.display().to_string())?;
    std::fs::rename(&part, path).with_context(|| path.display().to_string())
}

/// The result of a round; `None` while it is unfinished.
///
/// # Errors
/// If the file is not a result.
pub fn result_of(folder: &Path) -> Result<Option<RoundResult>> {
    let path = folder.join(RESULT);
    if !path.is_file() {
        return Ok(None);
    }
    let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    match serde_json::from_str(&text) {
        Ok(result) => Ok(Some(result)),
        Err(error) => bail!("{}: {error}", path.display()),
    }
}
