use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::json;
use wm_dataset::Latents;
use wm_evaluation::{Windows, on_predicted, on_real};
use wm_model::{
    Weights,
    transition::{ACTIONS_KEY, Transition},
};
use wm_motion::actions::ActionEncoding;
use wm_zoo::idm::TrainedIdm;

use super::{IdmRecipe, IdmTask};
use crate::{
    arguments::{HeldOutLatentArgs, LatentRunArgs, RunArgs},
    run::{RunEnd, Stop},
};

/// Predicted model steps of an evaluation.
const HORIZON: usize = 8;

/// Train the inverse dynamics model, which infers the actions between consecutive latents of a frozen encoder
#[derive(Clone, Debug, Args)]
pub struct TrainIdmArgs {
    /// Options of the training.
    #[command(flatten)]
    pub on: LatentRunArgs,
}

impl TrainIdmArgs {
    /// Trains until the last step, or until `stop` is set.
    ///
    /// # Errors
    /// If data, recipe, checkpoint or weights cannot be read or written, or the training diverges.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        let recipe: IdmRecipe = self.on.run.load_recipe([])?;
        let (_, on) = self.on.open()?;
        train_on(&self.on.run, &recipe, &on.train, on.held_out.as_ref(), stop)
    }
}

pub(super) fn train_on(
    run: &RunArgs,
    recipe: &IdmRecipe,
    train: &Latents,
    held_out: Option<&Latents>,
    stop: &Stop,
) -> Result<RunEnd> {
    let encoding = recipe.model.encoding(train.action_space())?;
    let mut task = IdmTask::new(recipe, &encoding, train, held_out, run)?;
    let data = [
        ("latent_space", json!(train.space().to_string())),
        ("data", json!(train.digest())),
        ("actions", json!(encoding)),
    ];
    let data = (task.clips.len(), data);
    run.train_on_clips(&mut task, recipe, data, stop)
}

/// Measure how well an inverse dynamics model infers actions, from real and from predicted latents
#[derive(Clone, Debug, Args)]
pub struct EvaluateIdmArgs {
    /// Evaluation data.
    #[command(flatten)]
    pub on: HeldOutLatentArgs,
    /// Weights of the inverse dynamics model
    #[arg(long)]
    pub weights: PathBuf,
    /// Weights of a transition model, to measure its predictions too
    #[arg(long)]
    pub transition: Option<PathBuf>,
    /// Most windows of predictions
    #[arg(long, default_value_t = usize::MAX)]
    pub windows: usize,
}

impl EvaluateIdmArgs {
    /// Prints the figures.
    ///
    /// # Errors
    /// If data or weights cannot be read, or do not fit.
    pub fn run(&self) -> Result<()> {
        let (_, _, latents) = self.on.open()?;
        let model = TrainedIdm::open(&self.weights)?;
        let (own, others) = ("the model", "the bags");
        model
            .encoding()
            .space()
            .expect_same(latents.action_space(), own, others)?;
        println!("real latents: {}", on_real(&model, &latents, usize::MAX)?);
        if let Some(path) = &self.transition {
            let weights = Weights::open(path)?;
            let encoding: ActionEncoding = weights.json(ACTIONS_KEY)?;
            let transition = Transition::from_weights(weights)
                .with_context(|| path.display().to_string())?
                .pack()?;
            let evaluation = Windows::new(&latents, &encoding, HORIZON, self.windows)?;
            let found = on_predicted(&model, &transition, &evaluation)?;
            println!("predicted latents: {found}");
        }
        Ok(())
    }
}
