//! Training of a whole world model: autoencoder, transition model and inverse dynamics model, and a success probe where
//! the data tell of outcomes, one after the other into one folder, which is then a model for the nodes.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use wm_dataset::{Data, DataOptions};
use wm_model::{Compute, Fit, NumberFormat};
use wm_zoo::{IDM_FILE, ModelFolder, PROBE_FILE};

use crate::{
    arguments::{RunArgs, fraction},
    autoencoder::TrainAutoencoderArgs,
    idm::TrainIdmArgs,
    probe::TrainProbeArgs,
    recipe::Override,
    run::{Ended, Stop, checkpoint, expect_nothing_to_overwrite},
    stopped,
    transition::TrainTransitionArgs,
};

/// Trains a whole world model into one folder: the autoencoder, then the transition model and the inverse dynamics model
/// on its latents, and a success probe where the data tell of outcomes. Run again, it goes on where it was interrupted.
#[derive(Clone, Debug, Args)]
pub struct TrainModelArgs {
    /// What to train on: bags, folders of bags, or folders that `wm dataset` prepared.
    #[arg(long, visible_alias = "bags", required = true, num_args = 1.., value_name = "PATH")]
    pub data: Vec<PathBuf>,
    /// How recordings become episodes, and which are for validation.
    #[command(flatten)]
    pub options: DataOptions,
    /// Folder of the model; pass it to the nodes as model:=FOLDER.
    #[arg(long)]
    pub out: PathBuf,
    /// Use this model's frozen encoder and decoder instead of training an autoencoder: tiny, or a model's folder.
    #[arg(long)]
    pub encoder: Option<String>,
    /// How pictures of another aspect become the model's: crop (the middle), stretch or pad (black bars) [default: crop]. An
    /// encoder that is given has its own.
    #[arg(long, value_name = "FIT", conflicts_with = "encoder")]
    pub fit: Option<Fit>,
    /// Fine-tune this model (tiny, or a model's folder) instead of beginning anew: its autoencoder, unless --encoder is
    /// given, its transition model, and those of the others that it has.
    #[arg(long, value_name = "MODEL")]
    pub from: Option<String>,
    /// Learning rate of what is taken from that model, as a fraction of the recipe's.
    #[arg(long, default_value_t = 0.3, value_name = "FRACTION", value_parser = fraction)]
    pub old_rate: f64,
    /// Train each part for this fraction of its recipe's length: 0.05 for a first look.
    #[arg(long, default_value_t = 1.0, value_name = "FRACTION", value_parser = fraction)]
    pub share: f64,
    /// Recipe of all parts, by name: tiny or paper (the autoencoder's is always tiny).
    #[arg(long, default_value = "tiny")]
    pub recipe: String,
    /// A setting of a part's recipe, as transition.optimisation.learning_rate=1e-3; may be repeated.
    #[arg(long, value_name = "PART.PATH=VALUE")]
    pub set: Vec<Override>,
    /// Folder for decoded frames and latents; `cache` in the output folder by default.
    #[arg(long)]
    pub cache: Option<PathBuf>,
    /// Number of threads; all of the machine by default.
    #[arg(long)]
    pub threads: Option<usize>,
    /// Where to compute: cpu, cuda or cuda:N. The autoencoder trains on the CPU in any case.
    #[arg(long, default_value = "cpu")]
    pub device: Compute,
}

/// The parts, in the order in which they are trained.
const PARTS: [&str; 4] = ["autoencoder", "transition", "idm", "probe"];

impl TrainModelArgs {
    /// Trains all parts, or until `stop` asks for the end.
    ///
    /// # Errors
    /// When a part cannot be trained.
    pub fn run(&self, stop: &Stop) -> Result<Ended> {
        let is_unknown = |setting: &&Override| !PARTS.contains(&setting.part());
        if let Some(setting) = self.set.iter().find(is_unknown) {
            anyhow::bail!(
                "--set {setting}: expected it to begin with one of {}",
                PARTS.join(", ")
            );
        }
        let own = self.out.display().to_string();
        let encoder = self.encoder.clone().unwrap_or(own);
        self.check(&encoder)?;
        let mut ended = Ended::Finished;
        for part in self.parts() {
            let run = self.of(part)?;
            let encoder = encoder.clone();
            println!("== {part}");
            ended = match part {
                "autoencoder" => TrainAutoencoderArgs { run, fit: self.fit }.run(stop)?,
                "transition" => TrainTransitionArgs { run, encoder }.run(stop)?,
                "idm" => TrainIdmArgs { run, encoder }.run(stop)?,
                _ => TrainProbeArgs {
                    run,
                    encoder,
                    text_tower: None,
                }
                .run_if_labelled(stop)?,
            };
            if ended == Ended::Stopped {
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

    /// Holds what all parts take against what is there, before hours go into the first of them.
    fn check(&self, encoder: &str) -> Result<()> {
        for model in self.encoder.iter().chain(&self.from) {
            ModelFolder::require(model)?;
        }
        let encoder = || encoder.to_owned();
        let autoencoder = TrainAutoencoderArgs {
            run: self.of("autoencoder")?,
            fit: self.fit,
        };
        autoencoder.recipe()?;
        let transition = TrainTransitionArgs {
            run: self.of("transition")?,
            encoder: encoder(),
        };
        transition.recipe()?;
        let idm = TrainIdmArgs {
            run: self.of("idm")?,
            encoder: encoder(),
        };
        idm.recipe()?;
        let probe = TrainProbeArgs {
            run: self.of("probe")?,
            encoder: encoder(),
            text_tower: None,
        };
        probe.recipe()?;
        Data::require(&self.data, &self.options)?;
        self.device.device()?;
        for part in self.parts() {
            if !checkpoint(&self.out, part).is_file() {
                let weights = format!("{part}.safetensors");
                expect_nothing_to_overwrite(&self.out, &[&weights])?;
            }
        }
        Ok(())
    }

    /// The model that a part is fine-tuned from, if any.
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
