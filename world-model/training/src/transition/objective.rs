use anyhow::{Result, ensure};
use candle_core::{D, DType, Device, Tensor};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use wm_model::{
    sampler::shift_time,
    transition::{ActionAlignment, Parametrisation, TemporalPattern, Transition},
};

use super::{ClipSource, TauDistribution};

/// Smallest noise level that is trained on: the velocity of the residual parametrisation is divided by it.
const SMALLEST_TAU: f64 = 0.01;

/// Noise level at which the weight of a clean-frame error stops rising towards that of a velocity error, 1 / tau^2.
const SOFTENING: f64 = 0.4;

/// What is minimised, on what clips.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Objective {
    /// Clips a step.
    pub clips: usize,
    /// Clips that are computed together.
    pub micro_batch: usize,
    /// Frames at the start of a clip that are given, not learned.
    pub history: usize,
    /// How noise levels are drawn.
    pub tau: TauDistribution,
    /// Time shift of the drawn noise levels.
    pub shift: f64,
    /// Standard deviation of the noise level s that history frames get: (z + s noise) / sqrt(1 + s^2).
    pub history_noise: f64,
    /// Part of the clips whose history holds the model's own predictions in place of the later frames.
    pub own_history: f64,
    /// Part of the clips that are given the null action.
    pub action_dropout: f64,
    /// Seed of clips and noise.
    pub seed: u64,
}

impl Objective {
    pub(super) fn validate(&self) -> Result<()> {
        ensure!(
            self.micro_batch > 0 && self.clips > 0 && self.clips.is_multiple_of(self.micro_batch),
            "{} clips per step cannot be split into batches of {}",
            self.clips,
            self.micro_batch
        );
        for (name, part) in [
            ("own-history", self.own_history),
            ("action-dropout", self.action_dropout),
        ] {
            ensure!(
                (0.0..=1.0).contains(&part),
                "{name} is {part}, expected 0 to 1"
            );
        }
        ensure!(
            self.shift > 0.0,
            "the shift is {}, expected above 0",
            self.shift
        );
        ensure!(
            self.history_noise >= 0.0,
            "the history noise is {}, expected at least 0",
            self.history_noise
        );
        Ok(())
    }

    /// The loss of one small batch of random clips.
    pub(super) fn loss(
        &self,
        model: &Transition,
        clips: &ClipSource<'_>,
        rng: &mut ChaCha8Rng,
    ) -> Result<Tensor> {
        let batch = Batch::draw(self, model, clips, rng)?;
        let own = rng.random_bool(self.own_history);
        let history = if own {
            batch.with_predictions(model, self.history)?
        } else {
            batch.history.clone()
        };
        batch.loss(model, &history, self.history)
    }

    fn draw_tau(&self, rng: &mut ChaCha8Rng) -> f32 {
        let tau = match self.tau {
            TauDistribution::Uniform => rng.random::<f64>(),
            TauDistribution::LogitNormal => {
                let normal: f64 = StandardNormal.sample(rng);
                1.0 / (1.0 + (-normal).exp())
            }
        };
        shift_time(tau, self.shift).max(SMALLEST_TAU) as f32
    }
}

/// Clips laid out as the model is used: all frames but the last are clean history, each seen by the later ones; the
/// frames to be learned come once more, noisy, each seeing the clean ones before it and itself.
struct Batch {
    /// (B, n - 1, h, w, C): frames 0..n - 1, slightly noised.
    history: Tensor,
    /// (B, n - H, h, w, C): frames H..n.
    target: Tensor,
    noise: Tensor,
    /// (B, n - H).
    tau: Tensor,
    /// (B, n - 1 + n - H, A): what is fed with each frame.
    actions: Tensor,
}

impl Batch {
    fn draw(
        objective: &Objective,
        model: &Transition,
        clips: &ClipSource<'_>,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self> {
        let (b, n, past) = (objective.micro_batch, clips.frames(), objective.history);
        ensure!(
            past >= 1 && past < n,
            "clips of {n} frames have no frame to learn after the {past} history frames"
        );
        let (h, w, c) = clips.shape();
        let a = clips.action_dim();
        let (mut latents, mut actions) = (Vec::new(), Vec::new());
        for _ in 0..b {
            clips.load(clips.draw(rng), &mut latents, &mut actions)?;
        }
        let latents = Tensor::from_vec(latents, (b, n, h, w, c), &Device::Cpu)?;
        let mut actions = Tensor::from_vec(actions, (b, n, a), &Device::Cpu)?;
        if objective.action_dropout > 0.0 {
            actions = drop_actions(&actions, objective.action_dropout, rng)?;
        }
        let later = n - past;
        let zero = |frames| Tensor::zeros((b, frames, a), DType::F32, &Device::Cpu);
        let actions = match model.config().action_alignment {
            // Every frame carries its own action, those to be learned too, as in the authors' release.
            ActionAlignment::WithFrame => Tensor::cat(
                &[
                    actions.narrow(1, 0, n - 1)?,
                    actions.narrow(1, past, later)?,
                ],
                1,
            )?,
            ActionAlignment::WithResult => Tensor::cat(
                &[
                    zero(1)?,
                    actions.narrow(1, 0, n - 2)?,
                    actions.narrow(1, past - 1, later)?,
                ],
                1,
            )?,
        };
        let clean = latents.narrow(1, 0, n - 1)?;
        let levels = (0..b * (n - 1)).map(|_| {
            let normal: f64 = StandardNormal.sample(rng);
            (normal * objective.history_noise) as f32
        });
        let levels = Tensor::from_vec(levels.collect(), (b, n - 1, 1, 1, 1), &Device::Cpu)?;
        let noised = (&clean + normals(clean.dims(), rng)?.broadcast_mul(&levels)?)?;
        let history = noised.broadcast_div(&(levels.sqr()? + 1.0)?.sqrt()?)?;
        let target = latents.narrow(1, past, later)?.contiguous()?;
        let noise = normals(target.dims(), rng)?;
        let tau: Vec<f32> = (0..b * later).map(|_| objective.draw_tau(rng)).collect();
        Ok(Self {
            history,
            target,
            noise,
            tau: Tensor::from_vec(tau, (b, later), &Device::Cpu)?,
            actions,
        })
    }

    fn loss(&self, model: &Transition, history: &Tensor, past: usize) -> Result<Tensor> {
        let (output, _, tau) = self.output(model, history, &self.tau, past)?;
        match model.config().parametrisation {
            Parametrisation::Velocity => {
                let velocity = (&self.noise - &self.target)?;
                Ok((output - velocity)?.sqr()?.mean_all()?)
            }
            Parametrisation::Residual => {
                let predicted = (output + self.previous(history, past)?)?;
                // An error of the clean frame is one of the velocity times tau. Dividing by all of it would spend the
                // training on small noise levels, where there is little left to predict.
                let weight = (tau.sqr()? + SOFTENING * SOFTENING)?.recip()?;
                let error = (predicted - &self.target)?.sqr()?;
                Ok(error.broadcast_mul(&weight)?.mean_all()?)
            }
        }
    }

    /// The network's output at the noisy frames, those frames, and tau as (B, n - H, 1, 1, 1).
    fn output(
        &self,
        model: &Transition,
        history: &Tensor,
        tau: &Tensor,
        past: usize,
    ) -> Result<(Tensor, Tensor, Tensor)> {
        let (b, later) = tau.dims2()?;
        let clean = history.dim(1)?;
        let wide = tau.reshape((b, later, 1, 1, 1))?;
        let x = (self.target.broadcast_mul(&(1.0 - &wide)?)? + self.noise.broadcast_mul(&wide)?)?;
        let frames = Tensor::cat(&[history, &x], 1)?;
        let levels = Tensor::cat(
            &[&Tensor::zeros((b, clean), DType::F32, &Device::Cpu)?, tau],
            D::Minus1,
        )?;
        let pattern = TemporalPattern::teacher_forcing(clean + 1, past);
        let output = model.output(&frames, &levels, &self.actions, &pattern)?;
        Ok((output.narrow(1, clean, later)?, x, wide))
    }

    /// The frame before each noisy one.
    fn previous(&self, history: &Tensor, past: usize) -> Result<Tensor> {
        Ok(history.narrow(1, past - 1, self.target.dim(1)?)?)
    }

    /// The history with the model's one-step predictions in place of the frames after the first H, so that it learns
    /// to go on from what it made itself.
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

/// Gives some clips the null action throughout: zeros, the last value 1.
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
    Ok(Tensor::from_vec(values, (b, n, a), &Device::Cpu)?)
}

fn normals(dims: &[usize], rng: &mut ChaCha8Rng) -> Result<Tensor> {
    let values: Vec<f32> = (0..dims.iter().product())
        .map(|_| StandardNormal.sample(rng))
        .collect();
    Ok(Tensor::from_vec(values, dims, &Device::Cpu)?)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;

    use super::super::{
        tests::{config, encoding, moving, objective},
        trainable,
    };
    use super::*;

    /// As in the authors' release: no frame of a clip has zeros in place of its action, those to be learned neither.
    #[test]
    fn every_frame_carries_its_own_recorded_action() {
        let dir = tempfile::tempdir().unwrap();
        let latents = moving(dir.path(), 4, 1);
        let encoding = encoding();
        let clips = ClipSource::new(&latents, &encoding, 5).unwrap();
        let config = config(Parametrisation::Velocity, ActionAlignment::WithFrame);
        let (_, model) = trainable(&config, 3).unwrap();
        let objective = objective();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let batch = Batch::draw(&objective, &model, &clips, &mut rng).unwrap();
        // Frames 0 to 3 clean, then 2 to 4 to be learned.
        let actions = batch.actions.narrow(2, 0, 1).unwrap().squeeze(2).unwrap();
        for row in actions.to_vec2::<f32>().unwrap() {
            assert_eq!(row.len(), 7);
            assert_eq!(row[4..6], row[2..4]);
            assert!(row.iter().all(|value| *value != 0.0), "{row:?}");
        }
    }
}
