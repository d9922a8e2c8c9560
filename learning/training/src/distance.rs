//! Training of the learnt distance: quantiles of the number of model steps from one latent to another (pinball loss).
//!
//! Pairs are frames of an episode; the logarithm of their distance is uniform. Some pairs are of two episodes, which count
//! as the longest distance, and some are one frame twice.

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
    DISTANCE_FILE as FILE,
    distance::{DISTANCE_KEY, DistanceConfig, DistanceNetwork, TrainedDistance},
};

use crate::{
    arguments::RunArgs,
    hindsight::HindsightSource,
    network_variables::{NetworkLearner, NetworkVariables},
    optimiser::ParameterValues,
    run::Task,
    trained_weights::trained_weights,
    transition::normals,
    workers::BatchLoss,
};
pub use arguments::TrainDistanceArgs;
pub use recipe::{DistanceModelRecipe, DistanceRecipe};

/// Pairs of evaluations during the training, and at its end.
const QUICK_PAIRS: usize = 256;
const ALL_PAIRS: usize = 2048;
/// Pairs evaluated together.
const TOGETHER: usize = 64;
/// Seed of these pairs.
const VALIDATION_SEED: u64 = 7;

/// A learnt distance in training.
struct DistanceTask<'a> {
    recipe: &'a DistanceRecipe,
    config: DistanceConfig,
    train: &'a Latents,
    ways: HindsightSource<'a>,
    held_out: Option<HindsightSource<'a>>,
    variables: NetworkVariables,
    model: DistanceNetwork,
    /// The distance written last.
    written: Option<TrainedDistance>,
}

impl<'a> DistanceTask<'a> {
    fn new(
        recipe: &'a DistanceRecipe,
        frame_skip: usize,
        (train, held_out): (&'a Latents, Option<&'a Latents>),
        run: &RunArgs,
    ) -> Result<Self> {
        crate::recipe::check_batch(recipe.batch, recipe.micro_batch)?;
        ensure!(
            recipe.others >= 0.0 && recipe.same >= 0.0 && recipe.others + recipe.same <= 1.0,
            "others is {} and same {}, expected shares of the pairs",
            recipe.others,
            recipe.same
        );
        let config = recipe.config(train.space());
        let fresh = run.fresh_weights(FILE, recipe.seed)?;
        let model = DistanceNetwork::load(&config, &fresh.loader())?;
        let ways = |latents| HindsightSource::new(latents, frame_skip, recipe.longest);
        Ok(Self {
            ways: ways(train)?.on(&run.device()?),
            held_out: held_out
                .map(|latents| ways(latents).context("the held-out bags"))
                .transpose()?,
            recipe,
            config,
            train,
            variables: NetworkVariables::fresh(fresh, recipe, run)?,
            model,
            written: None,
        })
    }

    /// Two frames, and the distance from the first to the second \[model steps\].
    fn draw(&self, rng: &mut ChaCha8Rng) -> (Vec<usize>, f64) {
        let way = self.ways.draw_near(rng);
        let kind: f64 = rng.random();
        if kind < self.recipe.others {
            // Now and then both are of one episode, where the distance is not the longest: rare with many episodes.
            let other = self.ways.draw(rng);
            return (vec![way.present, other.goal], self.config.longest);
        }
        if kind < self.recipe.others + self.recipe.same {
            return (vec![way.present, way.present], 0.0);
        }
        (vec![way.present, way.goal], self.ways.steps(way))
    }

    fn loss(&self, rng: &mut ChaCha8Rng) -> Result<Tensor> {
        let pairs: Vec<_> = (0..self.recipe.micro_batch)
            .map(|_| self.draw(rng))
            .collect();
        let (frames, steps): (Vec<_>, Vec<f64>) = pairs.into_iter().unzip();
        let latents = self.ways.tensor(&frames)?;
        let noise = normals(latents.dims(), latents.device(), rng)?;
        let latents = (latents + (noise * self.recipe.latent_noise)?)?;
        let values = steps.iter().map(|steps| self.config.value(*steps) as f32);
        let truth = Tensor::from_vec(
            values.collect::<Vec<_>>(),
            (steps.len(), 1),
            latents.device(),
        )?;
        pinball(
            &self.model.values(&latents)?,
            &truth,
            &self.config.quantiles,
        )
    }
}

/// Mean pinball loss of quantiles (B, Q) to the truth (B, 1): q e for e = truth - found above 0, (q - 1) e below.
fn pinball(found: &Tensor, truth: &Tensor, quantiles: &[f64]) -> Result<Tensor> {
    let error = truth.broadcast_sub(found)?;
    let quantiles: Vec<f32> = quantiles.iter().map(|quantile| *quantile as f32).collect();
    let quantiles = Tensor::new(quantiles.as_slice(), found.device())?.unsqueeze(0)?;
    let over = error.broadcast_mul(&quantiles)?;
    let under = error.broadcast_mul(&(quantiles - 1.0)?)?;
    Ok(over.maximum(&under)?.mean_all()?)
}

impl NetworkLearner for DistanceTask<'_> {
    fn variables(&self) -> &NetworkVariables {
        &self.variables
    }

    fn batch_loss(&self, _step: u64, rng: &mut ChaCha8Rng) -> Result<BatchLoss> {
        Ok(BatchLoss::from(self.loss(rng)?))
    }
}

impl Task for DistanceTask<'_> {
    fn name(&self) -> &'static str {
        "distance"
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
        let (config, space) = ((DISTANCE_KEY, &self.config), self.train.space());
        trained_weights(averaged, config, Some(space))?.write(&path)?;
        // From exactly the written file.
        self.written = Some(TrainedDistance::from_weights(Weights::open(&path)?)?);
        Ok(())
    }

    /// Mean absolute error of the median, and the share of the distances below each quantile.
    fn validate(&mut self, thorough: bool) -> Result<Vec<Figure>> {
        let (Some(held_out), Some(model)) = (&self.held_out, &self.written) else {
            return Ok(Vec::new());
        };
        let count = if thorough { ALL_PAIRS } else { QUICK_PAIRS };
        let mut rng = ChaCha8Rng::seed_from_u64(VALIDATION_SEED);
        let quantiles = model.quantiles();
        let median = quantiles.len() / 2;
        let (mut error, mut below) = (0.0, vec![0.0; quantiles.len()]);
        for _ in 0..count / TOGETHER {
            let ways: Vec<_> = (0..TOGETHER)
                .map(|_| held_out.draw_near(&mut rng))
                .collect();
            let rows: Vec<_> = ways.iter().map(|way| vec![way.present, way.goal]).collect();
            let found = model.steps(&held_out.tensor(&rows)?)?;
            for (way, found) in ways.iter().zip(found) {
                let truth = held_out.steps(*way);
                error += found.get(median).map_or(0.0, |steps| (steps - truth).abs());
                for (below, steps) in below.iter_mut().zip(&found) {
                    *below += f64::from(u8::from(truth <= *steps));
                }
            }
        }
        let n = (count / TOGETHER * TOGETHER) as f64;
        let shares = quantiles.iter().zip(below);
        let shares = shares.map(|(quantile, below)| {
            let name = format!("below_quantile_{:.0}", quantile * 100.0);
            Figure::new(name, below / n)
        });
        let error = Figure::new("error_steps".to_owned(), error / n);
        Ok(std::iter::once(error).chain(shares).collect())
    }
}

#[cfg(test)]
mod tests;
