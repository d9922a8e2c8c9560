//! Training of a whole world model in one folder for the nodes: autoencoder, transition model, inverse dynamics model,
//! and a success probe if the data have outcomes, in sequence.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use wm_dataset::{Data, DataOptions};
use wm_model::{Compute, Fit, NumberFormat};
use wm_zoo::{IDM_FILE, ModelFolder, PROBE_FILE};

use crate::{
    arguments::{LatentRunArgs, PictureRunArgs, RunArgs, fraction},
    autoencoder::TrainAutoencoderArgs,
    idm::{IdmRecipe, TrainIdmArgs},
    probe::{ProbeRecipe, TrainProbeArgs},
    recipe::Override,
    run::{RunEnd, Stop, checkpoint, expect_nothing_to_overwrite},
    stopped,
    transition::{ListenArgs, TrainTransitionArgs, TransitionRecipe},
};

/// Train a whole world model into one folder: the autoencoder, the transition model and the inverse dynamics model on its
/// latents, and a success probe if the data have outcomes. Run the command again to resume
#[derive(Clone, Debug, Args)]
pub struct TrainModelArgs {
    /// Data to train on: bags, folders of bags, or folders prepared by `wm dataset`
    #[arg(long, visible_alias = "bags", required = true, num_args = 1.., value_name = "PATH")]
    pub data: Vec<PathBuf>,
    /// Options of the data.
    #[command(flatten)]
    pub options: DataOptions,
    /// Folder of the model; pass it to the nodes as model:=FOLDER
    #[arg(long)]
    pub out: PathBuf,
    /// Model whose frozen encoder and decoder to use instead of training an autoencoder: tiny, or a model's folder
    #[arg(long)]
    pub encoder: Option<String>,
    /// How pictures of another aspect fit the model: crop (the middle), stretch or pad (black bars) [default: crop]. A
    /// given encoder has its own
    #[arg(long, value_name = "FIT", conflicts_with = "encoder")]
    pub fit: Option<Fit>,
    /// Model to fine-tune (tiny, or a model's folder): its autoencoder (unless --encoder is given), its transition
    /// model, and its other parts
    #[arg(long, value_name = "MODEL")]
    pub from: Option<String>,
    /// Learning rate of the fine-tuned weights, as a fraction of the recipe's
    #[arg(long, default_value_t = 0.3, value_name = "FRACTION", value_parser = fraction)]
    pub old_rate: f64,
    /// Fraction of each recipe's length to train; 0.05 for a first test
    #[arg(long, default_value_t = 1.0, value_name = "FRACTION", value_parser = fraction)]
    pub share: f64,
    /// Recipe of all parts by name: tiny or paper (the autoencoder's is always tiny)
    #[arg(long, default_value = "tiny")]
    pub recipe: String,
    /// Setting of a part's recipe, such as transition.optimisation.learning_rate=1e-3 (repeatable)
    #[arg(long, value_name = "PART.PATH=VALUE")]
    pub set: Vec<Override>,
    /// Folder for decoded frames and latents [default: `cache` in the output folder]
    #[arg(long)]
    pub cache: Option<PathBuf>,
    /// Number of threads [default: all of the machine]
    #[arg(long)]
    pub threads: Option<usize>,
    /// Device: cpu, cuda or cuda:N; the autoencoder always trains on the CPU
    #[arg(long, default_value = "cpu")]
    pub device: Compute,
    /// Worker processes of the transition model.
    #[command(flatten)]
    pub listen: ListenArgs,
}

/// Parts in the order of training.
const PARTS: [&str; 4] = ["autoencoder", "transition", "idm", "probe"];

impl TrainModelArgs {
    /// Trains all parts, or until `stop` is set.
    ///
    /// # Errors
    /// If a part cannot be trained.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        let is_unknown = |setting: &&Override| !PARTS.contains(&setting.part());
        if let Some(setting) = self.set.iter().find(is_unknown) {
            anyhow::bail!(
                "--set {setting}: expected it to begin with one of {}",
                PARTS.join(", ")
            );
        }
        let own = self.out.display().to_string();
        let encoder = self.encoder.clone().unwrap_or(own);
        self.check()?;
        let mut ended = RunEnd::Finished;
        for part in self.parts() {
            let run = self.of(part)?;
            let fit = self.fit;
            let on = |run| LatentRunArgs {
                run,
                encoder: encoder.clone(),
            };
            println!("== {part}");
            ended = match part {
                "autoencoder" => TrainAutoencoderArgs {
                    on: PictureRunArgs { run, fit },
                }
                .run(stop)?,
                "transition" => TrainTransitionArgs {
                    on: on(run),
                    listen: self.listen.clone(),
                }
                .run(stop)?,
                "idm" => TrainIdmArgs { on: on(run) }.run(stop)?,
                _ => TrainProbeArgs {
                    on: on(run),
                    text_tower: None,
                }
                .run_if_labelled(stop)?,
            };
            if ended == RunEnd::Stopped {
                println!("{}", stopped::summary(&self.out, &self.parts())?);
                return Ok(ended);
            }
        }
        crate::model_card::write(&self.of("transition")?);
        println!(
            "{} is a model: pass it to the nodes as model:={}",
            self.out.display(),
            self.out.display()
        );
        Ok(ended)
    }

    /// The parts to train.
    fn parts(&self) -> Vec<&'static str> {
        let is_given = |part: &str| part == "autoencoder" && self.encoder.is_some();
        PARTS.into_iter().filter(|part| !is_given(part)).collect()
    }

    /// Checks the inputs of all parts before the first training.
    fn check(&self) -> Result<()> {
        for model in self.encoder.iter().chain(&self.from) {
            ModelFolder::require(model)?;
        }
        let autoencoder = TrainAutoencoderArgs {
            on: PictureRunArgs {
                run: self.of("autoencoder")?,
                fit: self.fit,
            },
        };
        autoencoder.recipe()?;
        self.of("transition")?.load_recipe::<TransitionRecipe>([])?;
        self.of("idm")?.load_recipe::<IdmRecipe>([])?;
        self.of("probe")?.load_recipe::<ProbeRecipe>([])?;
        Data::require(&self.data, &self.options)?;
        self.device.device()?;
        self.listen.check()?;
        for part in self.parts() {
            if !checkpoint(&self.out, part).is_file() {
                let weights = format!("{part}.safetensors");
                expect_nothing_to_overwrite(&self.out, &[&weights])?;
            }
        }
        Ok(())
    }

    /// The model to fine-tune a part from, if any.
    fn begins_from(&self, part: &str) -> Result<Option<String>> {
        let Some(from) = &self.from else {
            return Ok(None);
        };
        let has = match part {
            "idm" => ModelFolder::open(from)?.weights(IDM_FILE)?.is_some(),
            "probe" => ModelFolder::open(from)?.weights(PROBE_FILE)?.is_some(),
            _ => true,
        };
        Ok(has.then(|| from.clone()))
    }

    fn of(&self, part: &str) -> Result<RunArgs> {
        let own = self.set.iter().filter(|setting| setting.part() == part);
        Ok(RunArgs {
            data: self.data.clone(),
            options: self.options.clone(),
            out: self.out.clone(),
            cache: self.cache.clone(),
            recipe: match part {
                "autoencoder" => "tiny".to_owned(),
                _ => self.recipe.clone(),
            },
            set: own.map(Override::of_part).collect(),
            steps: None,
            share: self.share,
            from: self.begins_from(part)?,
            old_rate: self.old_rate,
            threads: self.threads,
            device: match part {
                "autoencoder" => Compute::default(),
                _ => self.device.clone(),
            },
            dtype: NumberFormat::F32,
        })
    }
}
