//! Training of the model of subgoals: what comes between the present latent and a goal, at growing distances.
//!
//! Goals are later frames of the same episode. Of each batch, a part learns the expected subgoals (mean squared error), the
//! rest flow matching from noise. Errors of each distance count relative to those of persistence.

mod arguments;
mod recipe;

use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use candle_core::Tensor;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use wm_dataset::Latents;
use wm_evaluation::Figure;
use wm_model::Weights;
use wm_zoo::{
    SUBGOALS_FILE as FILE,
    subgoals::{SUBGOALS_KEY, SubgoalNetwork, SubgoalSampling, TrainedSubgoals},
};

use crate::{
    arguments::RunArgs,
    hindsight::{Hindsight, HindsightSource},
    network_variables::{NetworkLearner, NetworkVariables},
    optimiser::ParameterValues,
    run::Task,
    trained_weights::trained_weights,
    transition::normals,
    workers::BatchLoss,
};
pub use arguments::TrainSubgoalsArgs;
pub(crate) use arguments::frame_skip;
pub use recipe::{SubgoalModelRecipe, SubgoalRecipe};

/// Ways of evaluations during the training, and at its end.
const QUICK_WAYS: usize = 64;
const ALL_WAYS: usize = 500;
/// Ways from which the error of persistence is estimated.
const PERSISTENCE_WAYS: usize = 256;
/// Seed of these ways.
const VALIDATION_SEED: u64 = 7;
/// Noise level at which the weight of an error stops rising to that of a velocity's, 1 / tau^2.
const SOFTENING: f64 = 0.4;

/// A model of subgoals in training.
struct SubgoalTask<'a> {
    recipe: &'a SubgoalRecipe,
    train: &'a Latents,
    ways: HindsightSource<'a>,
    held_out: Option<HindsightSource<'a>>,
    /// Weight of each distance, (1, K, 1, 1, 1): the inverse error of persistence.
    weights: Tensor,
    variables: NetworkVariables,
    model: SubgoalNetwork,
    /// The model written last.
    written: Option<TrainedSubgoals>,
}

impl<'a> SubgoalTask<'a> {
    fn new(
        recipe: &'a SubgoalRecipe,
        frame_skip: usize,
        (train, held_out): (&'a Latents, Option<&'a Latents>),
        run: &RunArgs,
    ) -> Result<Self> {
        crate::recipe::check_batch(recipe.batch, recipe.micro_batch)?;
        ensure!(
            (0.0..=1.0).contains(&recipe.expected),
            "expected is {}, which must be a share of the samples",
            recipe.expected
        );
        let config = recipe.config(train.space(), frame_skip);
        let fresh = run.fresh_weights(FILE, recipe.seed)?;
        let model = SubgoalNetwork::load(&config, &fresh.loader())?;
        let farthest = config.distances.last().copied().unwrap_or_default();
        ensure!(
            recipe.longest >= farthest,
            "longest is {}, but the farthest subgoal is {farthest} model steps away",
            recipe.longest
        );
        let ways = |latents| HindsightSource::new(latents, frame_skip, recipe.longest);
        let mut task = Self {
            ways: ways(train)?.on(&run.device()?),
            held_out: held_out
                .map(|latents| ways(latents).context("the held-out bags"))
                .transpose()?,
            recipe,
            train,
            weights: Tensor::ones((1, 1, 1, 1, 1), candle_core::DType::F32, &run.device()?)?,
            variables: NetworkVariables::fresh(fresh, recipe, run)?,
            model,
            written: None,
        };
        task.weights = task.persistence()?.recip()?;
        Ok(task)
    }

    /// Mean squared change from the present frame to each subgoal, (1, K, 1, 1, 1).
    fn persistence(&self) -> Result<Tensor> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.recipe.seed);
        let ways: Vec<_> = (0..PERSISTENCE_WAYS)
            .map(|_| self.ways.draw(&mut rng))
            .collect();
        let frames = self.tensor(&self.ways, &ways)?;
        let subgoals = frames.narrow(1, 2, self.distances().len())?;
        let change = subgoals.broadcast_sub(&frames.narrow(1, 1, 1)?)?.sqr()?;
        let means = change.mean_keepdim((0, 2, 3, 4))?;
        // A still data set has no change.
        Ok((means + 1e-6)?)
    }

    fn distances(&self) -> &[usize] {
        &self.model.config().distances
    }

    /// Goal, present frame and subgoals, (B, 2 + K, h, w, C).
    fn tensor(&self, source: &HindsightSource<'_>, ways: &[Hindsight]) -> Result<Tensor> {
        let rows = ways.iter().map(|way| {
            let subgoals = self.distances().iter();
            let subgoals = subgoals.map(|steps| source.on_the_way(*way, *steps));
            [way.goal, way.present]
                .into_iter()
                .chain(subgoals)
                .collect()
        });
        source.tensor(&rows.collect::<Vec<_>>())
    }

    fn loss(&self, rng: &mut ChaCha8Rng) -> Result<Tensor> {
        let samples = self.recipe.micro_batch;
        let ways: Vec<_> = (0..samples).map(|_| self.ways.draw(rng)).collect();
        let frames = self.tensor(&self.ways, &ways)?;
        let device = frames.device();
        let given = frames.narrow(1, 0, 2)?;
        let noise = normals(given.dims(), device, rng)?;
        let given = (given + (noise * self.recipe.latent_noise)?)?;
        let truth = frames.narrow(1, 2, self.distances().len())?.contiguous()?;
        // Noise level, share of noise and weight of each sample.
        let drawn = (0..samples).map(|_| {
            let tau: f64 = rng.random();
            match rng.random_bool(self.recipe.expected) {
                true => (1.0, 0.0, 1.0),
                false => (tau, tau, 1.0 / (tau * tau + SOFTENING * SOFTENING)),
            }
        });
        let drawn: Vec<(f64, f64, f64)> = drawn.collect();
        let column = |of: fn(&(f64, f64, f64)) -> f64| -> Result<Tensor> {
            let values: Vec<f32> = drawn.iter().map(|each| of(each) as f32).collect();
            Ok(Tensor::from_vec(values, (samples, 1, 1, 1, 1), device)?)
        };
        let (tau, share, weight) = (column(|d| d.0)?, column(|d| d.1)?, column(|d| d.2)?);
        let clean = truth.broadcast_mul(&(1.0 - &tau)?)?;
        let noise = normals(truth.dims(), device, rng)?;
        let noised = (clean + noise.broadcast_mul(&share)?)?;
        let way = (&given.get_on_dim(1, 1)?, &given.get_on_dim(1, 0)?);
        let found = self.model.forward(way, (&noised, &tau.flatten_all()?))?;
        let error = (found - truth)?.sqr()?;
        let error = error.broadcast_mul(&self.weights)?.broadcast_mul(&weight)?;
        Ok(error.mean_all()?)
    }
}

impl NetworkLearner for SubgoalTask<'_> {
    fn variables(&self) -> &NetworkVariables {
        &self.variables
    }

    fn batch_loss(&self, _step: u64, rng: &mut ChaCha8Rng) -> Result<BatchLoss> {
        Ok(BatchLoss::from(self.loss(rng)?))
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
        let (config, space) = ((SUBGOALS_KEY, self.model.config()), self.train.space());
        trained_weights(averaged, config, Some(space))?.write(&path)?;
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
        let mut errors = vec![(0.0, 0.0); self.distances().len()];
        for _ in 0..count {
            let frames = self
                .tensor(held_out, &[held_out.draw(&mut rng)])?
                .squeeze(0)?;
            let (goal, present) = (frames.get(0)?, frames.get(1)?);
            let found = model.propose(&present, &goal, SubgoalSampling::Expected)?;
            for (index, (found, errors)) in found.iter().zip(&mut errors).enumerate() {
                let truth = frames.get(index + 2)?;
                errors.0 += squared_error(found, &truth)?;
                errors.1 += squared_error(&present, &truth)?;
            }
        }
        let figures = self.distances().iter().zip(errors);
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
