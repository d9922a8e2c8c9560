//! Training of the inverse dynamics model, which infers the actions between consecutive latents (the paper, appendix
//! B.6), by Smooth-L1 on the latents of a frozen encoder. The network is the paper's transformer, or a small
//! convolutional one.

mod arguments;
mod recipe;

use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use candle_core::{DType, Tensor};
use rand::Rng as _;
use rand_chacha::ChaCha8Rng;
use wm_dataset::{ClipSource, Latents};
use wm_evaluation::{Figure, on_real};
use wm_model::Weights;
use wm_motion::actions::ActionEncoding;
use wm_zoo::{
    Dropout, IDM_FILE as FILE,
    idm::{IDM_KEY, IdmNetwork, IdmNetworkConfig, TrainedIdm},
};

use crate::{
    arguments::RunArgs,
    hindsight::HindsightSource,
    network_variables::{NetworkLearner, NetworkVariables},
    optimiser::ParameterValues,
    run::Task,
    trained_weights::trained_weights_of_actions,
    transition::normals,
    workers::BatchLoss,
};
pub use arguments::{EvaluateIdmArgs, TrainIdmArgs};
pub use recipe::{IdmKind, IdmModelRecipe, IdmRecipe};

/// Windows of evaluations during the training.
pub(crate) const QUICK_WINDOWS: usize = 256;

/// An inverse dynamics model in training.
struct IdmTask<'a> {
    recipe: &'a IdmRecipe,
    config: IdmNetworkConfig,
    encoding: &'a ActionEncoding,
    train: &'a Latents,
    clips: ClipSource<'a>,
    /// Goals farther away than the last latent of a clip.
    goals: Option<HindsightSource<'a>>,
    held_out: Option<&'a Latents>,
    variables: NetworkVariables,
    model: IdmNetwork,
    /// The model written last.
    written: Option<TrainedIdm>,
}

impl<'a> IdmTask<'a> {
    fn new(
        recipe: &'a IdmRecipe,
        encoding: &'a ActionEncoding,
        train: &'a Latents,
        held_out: Option<&'a Latents>,
        run: &RunArgs,
    ) -> Result<Self> {
        crate::recipe::check_batch(recipe.batch, recipe.micro_batch)?;
        ensure!(
            (0.0..1.0).contains(&recipe.dropout),
            "dropout is {}, expected 0 up to 1",
            recipe.dropout
        );
        ensure!(
            recipe.longest <= 1 || recipe.model.horizon == 1,
            "longest is {}, which needs a model.horizon of 1, not {}",
            recipe.longest,
            recipe.model.horizon
        );
        let sizes = match run.old_config::<IdmNetworkConfig>(FILE, IDM_KEY)? {
            Some(old) => recipe.model.sized_as(&old),
            None => recipe.model.clone(),
        };
        let config = sizes.config(train.space().shape(), encoding)?;
        let fresh = run.fresh_weights(FILE, recipe.seed)?;
        let model = IdmNetwork::load(&config, &fresh.loader())?;
        let frames = config.horizon() + 1;
        if let Some(held_out) = held_out {
            ClipSource::new(held_out, encoding, frames).context("the held-out bags")?;
        }
        ensure!(
            (0.0..=1.0).contains(&recipe.last_goals),
            "last_goals is {}, expected 0 to 1",
            recipe.last_goals
        );
        ensure!(
            recipe.last_goals == 0.0 || recipe.longest > 1,
            "last_goals is {}, which needs a longest above 1, not {}",
            recipe.last_goals,
            recipe.longest
        );
        let goals = (recipe.longest > 1)
            .then(|| HindsightSource::new(train, encoding.frame_skip(), recipe.longest))
            .transpose()?;
        let device = run.device()?;
        Ok(Self {
            goals: goals.map(|goals| goals.on(&device)),
            clips: ClipSource::new(train, encoding, frames)?.on(&device),
            recipe,
            config,
            encoding,
            train,
            held_out,
            variables: NetworkVariables::fresh(fresh, recipe, run)?,
            model,
            written: None,
        })
    }

    /// Latents (B, k + 1, h, w, C) with the actions (B, k + 1, A) of their frames. The last latent may be a goal farther
    /// away.
    fn batch(&self, rng: &mut ChaCha8Rng) -> Result<(Tensor, Tensor)> {
        let clips: Vec<_> = (0..self.recipe.micro_batch)
            .map(|_| self.clips.draw(rng))
            .collect();
        let (latents, actions) = self.clips.tensors(&clips)?;
        let Some(source) = &self.goals else {
            return Ok((latents, actions));
        };
        let goals = clips.iter().map(|clip| {
            let present = self.clips.first_frame(*clip);
            vec![match rng.random_bool(self.recipe.last_goals) {
                true => source.last(present),
                false => source.later(present, rng),
            }]
        });
        let goals: Vec<_> = goals.collect();
        let presents = latents.narrow(1, 0, self.config.horizon())?;
        Ok((
            Tensor::cat(&[&presents, &source.tensor(&goals)?], 1)?,
            actions,
        ))
    }

    fn loss(&self, rng: &mut ChaCha8Rng) -> Result<Tensor> {
        let (latents, actions) = self.batch(rng)?;
        let latents = match self.recipe.latent_noise {
            0.0 => latents,
            deviation => {
                let noise = normals(latents.dims(), latents.device(), rng)?;
                (latents + (noise * deviation)?)?
            }
        };
        let mut dropout = Dropout::new(self.recipe.dropout, rng);
        loss(&self.model, (&latents, &actions), &mut dropout)
    }
}

/// Loss of windows of latents (B, k + 1, h, w, C) with the actions (B, k + 1, A) of their frames.
pub(crate) fn loss(
    model: &IdmNetwork,
    (latents, actions): (&Tensor, &Tensor),
    dropout: &mut Dropout<'_>,
) -> Result<Tensor> {
    // The last frame's action leads out of the window.
    let truth = actions.narrow(1, 0, model.horizon())?;
    smooth_l1(&model.forward_dropping(latents, dropout)?, &truth)
}

/// Mean of d^2 / 2 for |d| below 1, and of |d| - 1/2 elsewhere: `torch.nn.SmoothL1Loss()`.
fn smooth_l1(found: &Tensor, truth: &Tensor) -> Result<Tensor> {
    let distance = (found - truth)?.abs()?;
    let is_small = distance.detach().lt(1.0)?.to_dtype(DType::F32)?;
    let square = (distance.sqr()? * 0.5)?;
    let line = (distance - 0.5)?;
    let loss = ((&is_small * square)? + ((1.0 - &is_small)? * line)?)?;
    Ok(loss.mean_all()?)
}

impl NetworkLearner for IdmTask<'_> {
    fn variables(&self) -> &NetworkVariables {
        &self.variables
    }

    fn batch_loss(&self, _step: u64, rng: &mut ChaCha8Rng) -> Result<BatchLoss> {
        Ok(BatchLoss::from(self.loss(rng)?))
    }
}

impl Task for IdmTask<'_> {
    fn name(&self) -> &'static str {
        "idm"
    }

    fn files(&self) -> &'static [&'static str] {
        &[FILE]
    }

    fn write(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
        folder: &Path,
    ) -> Result<()> {
        let (config, space) = ((IDM_KEY, &self.config), self.train.space());
        let path = folder.join(FILE);
        trained_weights_of_actions(averaged, config, space, self.encoding)?.write(&path)?;
        // From exactly the written file.
        self.written = Some(TrainedIdm::from_weights(Weights::open(&path)?)?);
        Ok(())
    }

    fn validate(&mut self, thorough: bool) -> Result<Vec<Figure>> {
        let (Some(held_out), Some(model)) = (self.held_out, &self.written) else {
            return Ok(Vec::new());
        };
        let most = if thorough { usize::MAX } else { QUICK_WINDOWS };
        Ok(on_real(model, held_out, most)?.figures())
    }
}

#[cfg(test)]
mod parity;
#[cfg(test)]
pub(crate) mod tests;
