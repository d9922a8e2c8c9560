use anyhow::{Result, bail, ensure};
use candle_core::{D, Device, Tensor};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use wm_dataset::{Clip, ClipSource};
use wm_model::{
    sampler::shift_time,
    transition::{ActionAlignment, Parametrisation, TemporalPattern, Transition, TransitionConfig},
};

use super::{draws::Draws, noised_at_once, object_weights::ObjectWeights};

/// Least trained noise level: the velocity of the residual parametrisation is divided by it.
const SMALLEST_TAU: f64 = 0.01;

/// Noise level at which the weight of a clean-frame error stops rising to that of a velocity error, 1 / tau^2.
const SOFTENING: f64 = 0.4;

/// Distribution of noise levels before the time shift.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TauDistribution {
    /// Uniform over 0..1.
    Uniform,
    /// The logistic function of a standard normal variable.
    LogitNormal,
}

/// What learned frames see of each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Forcing {
    /// Clean predecessors: as in use.
    Teacher,
    /// Each other's noisy frames, each at its own level: the paper's diffusion forcing.
    Diffusion,
}

/// The objective, explained in `recipes/*/transition.yaml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectiveRecipe {
    /// What learned frames see of each other.
    pub forcing: Forcing,
    /// Given frames at the start of a clip.
    pub history: usize,
    /// Distribution of noise levels.
    pub tau: TauDistribution,
    /// Standard deviation of the noise level s that history frames get: (z + s noise) / sqrt(1 + s^2).
    pub history_noise: f64,
    /// Share of the clips whose history has the model's own predictions for its later frames.
    pub own_history: f64,
    /// Share of the clips with the null action.
    pub action_dropout: f64,
    /// How much more the objects of the masks count than anything else.
    #[serde(default)]
    pub object_weight: f64,
}

/// The objective with its clips.
#[derive(Clone, Debug, PartialEq)]
pub struct Objective {
    /// Clips per step.
    pub clips: usize,
    /// Clips computed together.
    pub micro_batch: usize,
    /// Time shift of the drawn noise levels.
    pub shift: f64,
    /// Seed of clips and noise.
    pub seed: u64,
    /// The objective.
    pub recipe: ObjectiveRecipe,
}

impl Objective {
    pub(crate) fn validate(&self, config: &TransitionConfig) -> Result<()> {
        let recipe = &self.recipe;
        crate::recipe::check_batch(self.clips, self.micro_batch)?;
        ensure!(
            (1..config.max_frames).contains(&recipe.history),
            "objective.history is {}: clips of {} frames have no frame to learn after it",
            recipe.history,
            config.max_frames
        );
        for (name, part) in [
            ("own_history", recipe.own_history),
            ("action_dropout", recipe.action_dropout),
        ] {
            ensure!(
                (0.0..=1.0).contains(&part),
                "objective.{name} is {part}, expected 0 to 1"
            );
        }
        ensure!(
            recipe.history_noise >= 0.0,
            "objective.history_noise is {}, expected at least 0",
            recipe.history_noise
        );
        ensure!(
            recipe.object_weight >= 0.0,
            "objective.object_weight is {}, expected at least 0",
            recipe.object_weight
        );
        if recipe.forcing == Forcing::Diffusion {
            ensure!(
                recipe.object_weight == 0.0,
                "objective.object_weight is {}, which needs objective.forcing: teacher",
                recipe.object_weight
            );
            ensure!(
                config.parametrisation == Parametrisation::Velocity,
                "objective.forcing is diffusion, where the frame before may be noisy: model.predicts must be velocity"
            );
            ensure!(
                recipe.own_history == 0.0,
                "objective.own_history is {}, which needs objective.forcing: teacher",
                recipe.own_history
            );
        }
        Ok(())
    }

    /// Loss of one small batch of random clips.
    pub(super) fn loss(
        &self,
        model: &Transition,
        (clips, objects): (&ClipSource<'_>, Option<&ObjectWeights<'_>>),
        rng: &mut ChaCha8Rng,
    ) -> Result<Tensor> {
        let drawn = self.draw_places(clips, rng);
        let (latents, actions) = self.load(clips, &drawn, rng)?;
        if self.recipe.forcing == Forcing::Diffusion {
            let draws = self.draw(latents.dims(), latents.device(), rng)?;
            return noised_at_once::loss(model, (&latents, &actions), &draws, self.recipe.history);
        }
        let mut batch = Batch::of(self, model, (&latents, &actions), rng)?;
        if let Some(objects) = objects {
            let weights = objects.of(clips, &drawn, latents.device())?;
            let past = self.recipe.history;
            batch.weights = Some(weights.narrow(1, past, weights.dim(1)? - past)?);
        }
        let own = rng.random_bool(self.recipe.own_history);
        batch.loss_after(model, own, self.recipe.history)
    }

    /// Clips (B, n, h, w, C) with the actions (B, n, A) of their frames; some have the null action.
    pub(crate) fn draw_clips(
        &self,
        clips: &ClipSource<'_>,
        rng: &mut ChaCha8Rng,
    ) -> Result<(Tensor, Tensor)> {
        let drawn = self.draw_places(clips, rng);
        self.load(clips, &drawn, rng)
    }

    fn draw_places(&self, clips: &ClipSource<'_>, rng: &mut ChaCha8Rng) -> Vec<Clip> {
        (0..self.micro_batch).map(|_| clips.draw(rng)).collect()
    }

    fn load(
        &self,
        clips: &ClipSource<'_>,
        drawn: &[Clip],
        rng: &mut ChaCha8Rng,
    ) -> Result<(Tensor, Tensor)> {
        let (latents, actions) = clips.tensors(drawn)?;
        let part = self.recipe.action_dropout;
        if part > 0.0 {
            return Ok((latents, drop_actions(&actions, part, rng)?));
        }
        Ok((latents, actions))
    }

    /// Random numbers for the loss of clips of these dimensions, (B, n, h, w, C).
    fn draw(&self, clips: &[usize], device: &Device, rng: &mut ChaCha8Rng) -> Result<Draws> {
        let &[b, n, h, w, c] = clips else {
            bail!("clips of dimensions {clips:?}, expected (B, n, h, w, C)");
        };
        let past = self.recipe.history;
        let later = n - past;
        let clean = match self.recipe.forcing {
            Forcing::Teacher => n - 1,
            Forcing::Diffusion => past,
        };
        let levels = (0..b * clean).map(|_| {
            let normal: f64 = StandardNormal.sample(rng);
            (normal * self.recipe.history_noise) as f32
        });
        Ok(Draws {
            history_levels: Tensor::from_vec(levels.collect(), (b, clean), device)?,
            history_noise: normals(&[b, clean, h, w, c], device, rng)?,
            noise: normals(&[b, later, h, w, c], device, rng)?,
            tau: {
                let tau = (0..b * later).map(|_| self.draw_tau(rng));
                Tensor::from_vec(tau.collect(), (b, later), device)?
            },
        })
    }

    fn draw_tau(&self, rng: &mut ChaCha8Rng) -> f32 {
        let tau = match self.recipe.tau {
            TauDistribution::Uniform => rng.random::<f64>(),
            TauDistribution::LogitNormal => {
                let normal: f64 = StandardNormal.sample(rng);
                1.0 / (1.0 + (-normal).exp())
            }
        };
        shift_time(tau, self.shift).max(SMALLEST_TAU) as f32
    }
}

/// Clips arranged as the model is used: all frames except the last are clean history, seen by later ones; the learned frames
/// come again, noisy, and see the earlier clean ones and themselves.
pub(crate) struct Batch {
    /// (B, n - 1, h, w, C): frames 0..n - 1, slightly noised.
    pub(crate) history: Tensor,
    /// (B, n - H, h, w, C): frames H..n.
    pub(crate) target: Tensor,
    pub(crate) noise: Tensor,
    /// (B, n - H).
    tau: Tensor,
    /// (B, n - 1 + n - H, A), by frame.
    actions: Tensor,
    /// Of the squared errors, (B, n - H, h, w, 1); `None` stands for ones.
    weights: Option<Tensor>,
}

impl Batch {
    pub(crate) fn draw(
        objective: &Objective,
        model: &Transition,
        clips: &ClipSource<'_>,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self> {
        let (latents, actions) = objective.draw_clips(clips, rng)?;
        Self::of(objective, model, (&latents, &actions), rng)
    }

    /// Clips (B, n, h, w, C) with the actions (B, n, A) of their frames, under random noise.
    pub(crate) fn of(
        objective: &Objective,
        model: &Transition,
        (latents, actions): (&Tensor, &Tensor),
        rng: &mut ChaCha8Rng,
    ) -> Result<Self> {
        let draws = objective.draw(latents.dims(), latents.device(), rng)?;
        let alignment = model.config().action_alignment;
        let past = objective.recipe.history;
        Self::new(alignment, (latents, actions), &draws, past)
    }

    /// From clips (B, n, h, w, C) with the actions (B, n, A) of their frames.
    fn new(
        alignment: ActionAlignment,
        (latents, actions): (&Tensor, &Tensor),
        draws: &Draws,
        past: usize,
    ) -> Result<Self> {
        let n = latents.dim(1)?;
        let later = n - past;
        let actions = match alignment {
            // Every frame carries its own action, learned ones too, as in the authors' release.
            ActionAlignment::WithFrame => Tensor::cat(
                &[
                    actions.narrow(1, 0, n - 1)?,
                    actions.narrow(1, past, later)?,
                ],
                1,
            )?,
            ActionAlignment::WithResult => Tensor::cat(
                &[
                    actions.narrow(1, 0, 1)?.zeros_like()?,
                    actions.narrow(1, 0, n - 2)?,
                    actions.narrow(1, past - 1, later)?,
                ],
                1,
            )?,
        };
        let clean = latents.narrow(1, 0, n - 1)?.contiguous()?;
        Ok(Self {
            history: draws.as_history(&clean)?,
            target: latents.narrow(1, past, later)?.contiguous()?,
            noise: draws.noise.clone(),
            tau: draws.tau.clone(),
            actions,
            weights: None,
        })
    }

    /// Loss after the clips' own history, or after the model's predictions of it.
    pub(crate) fn loss_after(&self, model: &Transition, own: bool, past: usize) -> Result<Tensor> {
        let history = if own {
            self.with_predictions(model, past)?
        } else {
            self.history.clone()
        };
        self.loss(model, &history, past)
    }

    fn loss(&self, model: &Transition, history: &Tensor, past: usize) -> Result<Tensor> {
        let (output, _, tau) = self.output(model, history, &self.tau, past)?;
        match model.config().parametrisation {
            Parametrisation::Velocity => {
                let velocity = (&self.noise - &self.target)?;
                self.mean((output - velocity)?.sqr()?)
            }
            Parametrisation::Residual => {
                let predicted = (output + self.previous(history, past)?)?;
                // An error of the clean frame is the velocity's times tau. Full division would spend the training on small noise
                // levels, with little left to predict.
                let weight = (tau.sqr()? + SOFTENING * SOFTENING)?.recip()?;
                let error = (predicted - &self.target)?.sqr()?;
                self.mean(error.broadcast_mul(&weight)?)
            }
        }
    }

    /// Mean of the squared errors (B, n - H, h, w, C) with their weights.
    fn mean(&self, errors: Tensor) -> Result<Tensor> {
        let errors = match &self.weights {
            Some(weights) => errors.broadcast_mul(weights)?,
            None => errors,
        };
        Ok(errors.mean_all()?)
    }

    /// Output of the network at the noisy frames, these frames, and tau as (B, n - H, 1, 1, 1).
    fn output(
        &self,
        model: &Transition,
        history: &Tensor,
        tau: &Tensor,
        past: usize,
    ) -> Result<(Tensor, Tensor, Tensor)> {
        let (b, later) = tau.dims2()?;
        let x = self.noised(tau)?;
        let output = self.output_at(model, history, (&x, tau), 0.0, past)?;
        Ok((output, x, tau.reshape((b, later, 1, 1, 1))?))
    }

    /// The learned frames at noise levels `tau` (B, n - H).
    pub(crate) fn noised(&self, tau: &Tensor) -> Result<Tensor> {
        let (b, later) = tau.dims2()?;
        let tau = tau.reshape((b, later, 1, 1, 1))?;
        let clean = self.target.broadcast_mul(&(1.0 - &tau)?)?;
        Ok((clean + self.noise.broadcast_mul(&tau)?)?)
    }

    /// Output of the network at noisy frames (B, n - H, h, w, C) of levels (B, n - H), after a history with the declared level
    /// `context_tau`.
    pub(crate) fn output_at(
        &self,
        model: &Transition,
        history: &Tensor,
        (x, tau): (&Tensor, &Tensor),
        context_tau: f64,
        past: usize,
    ) -> Result<Tensor> {
        let (b, later) = tau.dims2()?;
        let clean = history.dim(1)?;
        let frames = Tensor::cat(&[history, x], 1)?;
        let context = Tensor::full(context_tau as f32, (b, clean), tau.device())?;
        let levels = Tensor::cat(&[&context, tau], D::Minus1)?;
        let pattern = TemporalPattern::teacher_forcing(clean + 1, past);
        Ok(model.output(&frames, &levels, &self.actions, &pattern, later)?)
    }

    /// The predecessor of each noisy frame.
    pub(crate) fn previous(&self, history: &Tensor, past: usize) -> Result<Tensor> {
        Ok(history.narrow(1, past - 1, self.target.dim(1)?)?)
    }

    /// The history with the model's one-step predictions after the first H frames, so that it learns to continue from its own
    /// predictions.
    fn with_predictions(&self, model: &Transition, past: usize) -> Result<Tensor> {
        let ones = self.tau.ones_like()?;
        let (output, x, _) = self.output(model, &self.history, &ones, past)?;
        let previous = self.previous(&self.history, past)?;
        let velocity = model
            .config()
            .parametrisation
            .velocity(&output, &x, &ones, &previous)?;
        let predicted = (x - velocity)?.detach();
        let kept = self.history.narrow(1, 0, past)?;
        let replaced = predicted.narrow(1, 0, self.history.dim(1)? - past)?;
        Ok(Tensor::cat(&[kept, replaced], 1)?)
    }
}

/// Gives some clips the null action throughout: zeros, and a last value of 1.
fn drop_actions(actions: &Tensor, part: f64, rng: &mut ChaCha8Rng) -> Result<Tensor> {
    let (b, n, a) = actions.dims3()?;
    let mut values = actions.flatten_all()?.to_vec1::<f32>()?;
    for clip in values.chunks_exact_mut(n * a) {
        if rng.random_bool(part) {
            for action in clip.chunks_exact_mut(a) {
                action.fill(0.0);
                if let Some(flag) = action.last_mut() {
                    *flag = 1.0;
                }
            }
        }
    }
    Ok(Tensor::from_vec(values, (b, n, a), actions.device())?)
}

/// Standard normal values, drawn on the CPU so that they do not depend on the device.
pub(crate) fn normals(dims: &[usize], device: &Device, rng: &mut ChaCha8Rng) -> Result<Tensor> {
    let values: Vec<f32> = (0..dims.iter().product())
        .map(|_| StandardNormal.sample(rng))
        .collect();
    Ok(Tensor::from_vec(values, dims, device)?)
}

#[cfg(test)]
mod parity;
#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;

    use super::super::tests::{config, encoding, fresh, moving, objective};
    use super::*;

    /// As in the authors' release: no frame has zeros instead of its action, not even learned ones.
    #[test]
    fn every_frame_carries_its_own_recorded_action() {
        let dir = tempfile::tempdir().unwrap();
        let latents = moving(dir.path(), 4, 1);
        let encoding = encoding();
        let clips = ClipSource::new(&latents, &encoding, 5).unwrap();
        let config = config(Parametrisation::Velocity, ActionAlignment::WithFrame);
        let (_, model) = fresh(&config, 3);
        let objective = objective(Forcing::Teacher);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let batch = Batch::draw(&objective, &model, &clips, &mut rng).unwrap();
        // Frames 0 to 3 clean, then 2 to 4 to learn.
        let actions = batch.actions.narrow(2, 0, 1).unwrap().squeeze(2).unwrap();
        for row in actions.to_vec2::<f32>().unwrap() {
            assert_eq!(row.len(), 7);
            assert_eq!(row[4..6], row[2..4]);
            assert!(row.iter().all(|value| *value != 0.0), "{row:?}");
        }
    }

    #[test]
    fn cells_count_by_their_weights() {
        let dir = tempfile::tempdir().unwrap();
        let latents = moving(dir.path(), 4, 1);
        let encoding = encoding();
        let clips = ClipSource::new(&latents, &encoding, 5).unwrap();
        let config = config(Parametrisation::Residual, ActionAlignment::WithResult);
        let (_, model) = fresh(&config, 3);
        let objective = objective(Forcing::Teacher);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut batch = Batch::draw(&objective, &model, &clips, &mut rng).unwrap();
        let past = objective.recipe.history;
        let (b, later, h, w, _) = batch.target.dims5().unwrap();
        let mut loss = |weights: Vec<f32>| {
            batch.weights =
                Some(Tensor::from_vec(weights, (b, later, h, w, 1), &Device::Cpu).unwrap());
            let loss = batch.loss_after(&model, false, past).unwrap();
            loss.to_scalar::<f32>().unwrap()
        };
        let cells = b * later * h * w;
        let (ones, twos) = (loss(vec![1.0; cells]), loss(vec![2.0; cells]));
        assert!((twos / ones - 2.0).abs() < 1e-5, "{twos} {ones}");
        let left = |cell: usize| if cell.is_multiple_of(w) { 1.0 } else { 0.0 };
        let first = loss((0..cells).map(left).collect());
        let others = loss((0..cells).map(|cell| 1.0 - left(cell)).collect());
        assert!(
            first > 0.0 && (first + others - ones).abs() < 1e-5,
            "{first} {others} {ones}"
        );
    }
}
