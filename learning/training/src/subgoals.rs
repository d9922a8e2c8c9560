//! Training of the model of subgoals: what comes between the present latent and a goal, at growing distances.
//!
//! Flow matching by the transition model's objective, on clips of the goal, the present frame and the subgoals. Goals
//! are later frames of the same episode. The weights start from those of the encoder's transition model where they fit:
//! it knows already how the robot and objects look in latents.

mod arguments;
mod recipe;

use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use candle_core::{Device, Tensor};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use wm_dataset::Latents;
use wm_evaluation::Figure;
use wm_model::{
    Weights,
    transition::{CONFIG_KEY, Transition, TransitionConfig, WeightGradients},
};
use wm_zoo::{
    SUBGOALS_FILE as FILE,
    subgoals::{SUBGOALS_KEY, SubgoalConfig, SubgoalSampling, TrainedSubgoals, condition},
};

use crate::{
    arguments::RunArgs,
    fresh_weights::FreshWeights,
    hindsight::{Hindsight, HindsightSource},
    network_variables::{NetworkLearner, NetworkVariables},
    optimiser::ParameterValues,
    run::Task,
    trained_weights::trained_weights,
    transition::{Batch, Objective, trainable},
    workers::BatchLoss,
};
pub use arguments::TrainSubgoalsArgs;
pub(crate) use arguments::frame_skip;
pub use recipe::{SubgoalModelRecipe, SubgoalRecipe};

/// Ways of evaluations during the training, and at its end.
const QUICK_WAYS: usize = 48;
const ALL_WAYS: usize = 400;
/// Seed of these ways.
const VALIDATION_SEED: u64 = 7;

/// A model of subgoals in training.
struct SubgoalTask<'a> {
    config: TransitionConfig,
    subgoals: SubgoalConfig,
    objective: Objective,
    train: &'a Latents,
    ways: HindsightSource<'a>,
    held_out: Option<HindsightSource<'a>>,
    variables: NetworkVariables,
    model: Transition,
    /// The model written last.
    written: Option<TrainedSubgoals>,
}

impl<'a> SubgoalTask<'a> {
    fn new(
        recipe: &SubgoalRecipe,
        (frame_skip, fresh): (usize, FreshWeights),
        (train, held_out): (&'a Latents, Option<&'a Latents>),
        run: &RunArgs,
    ) -> Result<Self> {
        let subgoals = SubgoalConfig {
            distances: recipe.distances.clone(),
        };
        subgoals.validate()?;
        let farthest = recipe.distances.last().copied().unwrap_or_default();
        ensure!(
            recipe.longest >= farthest,
            "longest is {}, but the farthest subgoal is {farthest} model steps away",
            recipe.longest
        );
        let config = recipe.config(train, &subgoals, frame_skip)?;
        let model = trainable(&config, &fresh, recipe.seed)?;
        let ways = |latents| HindsightSource::new(latents, frame_skip, recipe.longest);
        Ok(Self {
            objective: recipe.objective(&config)?,
            ways: ways(train)?.on(&run.device()?),
            held_out: held_out
                .map(|latents| ways(latents).context("the held-out bags"))
                .transpose()?,
            config,
            subgoals,
            train,
            // Weights of the transition model have to change as much as the new ones.
            variables: NetworkVariables::new(fresh.into_variables().0, recipe, run)?,
            model,
            written: None,
        })
    }

    /// Goal, present frame and subgoals.
    fn frames(&self, ways: &HindsightSource<'_>, way: Hindsight) -> Vec<usize> {
        let subgoals = self.subgoals.distances.iter();
        let subgoals = subgoals.map(|steps| ways.on_the_way(way, *steps));
        [way.goal, way.present]
            .into_iter()
            .chain(subgoals)
            .collect()
    }

    /// Conditions (B, n, 1) that lead from each frame to the next.
    fn conditions(&self, samples: usize, device: &Device) -> Result<Tensor> {
        let distances = self.subgoals.distances.iter();
        let values = std::iter::once(0.0)
            .chain(distances.map(|distance| condition(*distance)))
            // From the last frame, to none.
            .chain([0.0]);
        let values: Vec<f32> = values.collect();
        let row = Tensor::new(values.as_slice(), device)?;
        let frames = self.subgoals.frames();
        Ok(row.reshape((1, frames, 1))?.repeat((samples, 1, 1))?)
    }
}

impl NetworkLearner for SubgoalTask<'_> {
    fn variables(&self) -> &NetworkVariables {
        &self.variables
    }

    fn batch_loss(&self, _step: u64, rng: &mut ChaCha8Rng) -> Result<BatchLoss> {
        let samples = self.objective.micro_batch;
        let rows = (0..samples).map(|_| self.frames(&self.ways, self.ways.draw(rng)));
        let latents = self.ways.tensor(&rows.collect::<Vec<_>>())?;
        let conditions = self.conditions(samples, latents.device())?;
        let gradients = WeightGradients::default();
        let model = self.model.collecting(&gradients);
        let batch = Batch::of(&self.objective, &model, (&latents, &conditions), rng)?;
        let loss = batch.loss_after(&model, false, self.objective.recipe.history)?;
        Ok(BatchLoss {
            gradients,
            ..BatchLoss::from(loss)
        })
    }
}

impl Task for SubgoalTask<'_> {
    fn name(&self) -> &'static str {
        "subgoals"
    }

    fn files(&self) -> &'static [&'static str] {
        &[FILE]
    }

    fn write(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
        folder: &Path,
    ) -> Result<()> {
        let path = folder.join(FILE);
        let (config, space) = ((CONFIG_KEY, &self.config), self.train.space());
        let mut weights = trained_weights(averaged, config, Some(space))?;
        weights.metadata(SUBGOALS_KEY, serde_json::to_string(&self.subgoals)?);
        weights.write(&path)?;
        // From exactly the written file.
        self.written = Some(TrainedSubgoals::from_weights(Weights::open(&path)?)?);
        Ok(())
    }

    /// Squared error of the expected subgoals over that of persistence.
    fn validate(&mut self, thorough: bool) -> Result<Vec<Figure>> {
        let (Some(held_out), Some(model)) = (&self.held_out, &self.written) else {
            return Ok(Vec::new());
        };
        let count = if thorough { ALL_WAYS } else { QUICK_WAYS };
        let mut rng = ChaCha8Rng::seed_from_u64(VALIDATION_SEED);
        let distances = &self.subgoals.distances;
        let mut errors = vec![(0.0, 0.0); distances.len()];
        for _ in 0..count {
            let way = held_out.draw(&mut rng);
            let frames = held_out.tensor(&[self.frames(held_out, way)])?.squeeze(0)?;
            let (goal, present) = (frames.get(0)?, frames.get(1)?);
            let found = model.propose(&present, &goal, SubgoalSampling::Expected)?;
            for (index, (found, errors)) in found.iter().zip(&mut errors).enumerate() {
                let truth = frames.get(index + 2)?;
                errors.0 += squared_error(found, &truth)?;
                errors.1 += squared_error(&present, &truth)?;
            }
        }
        let figures = distances.iter().zip(errors);
        Ok(figures
            .map(|(distance, (own, persistence))| {
                Figure::new(format!("ratio_k{distance}"), own / persistence)
            })
            .collect())
    }
}

fn squared_error(a: &Tensor, b: &Tensor) -> Result<f64> {
    Ok(f64::from((a - b)?.sqr()?.mean_all()?.to_scalar::<f32>()?))
}

#[cfg(test)]
mod tests;
