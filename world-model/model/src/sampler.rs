//! Sampling: predicted latents, one model step after the other.
//!
//! A [`Rollout`] starts from a few observed latents and predicts one frame for each action that it
//! is given. Each frame starts from seeded noise and is integrated with Euler steps from noise
//! level 1 to 0; then it is part of the context of the next one. When the window is full, the
//! oldest frame leaves it.
//!
//! ```
//! use candle_core::{DType, Device, Tensor};
//! use wm_model::sampler::Rollout;
//! use wm_model::transition::{Transition, TransitionConfig};
//!
//! # fn main() -> wm_model::Result<()> {
//! let config = TransitionConfig::preset("tiny", (8, 8, 4), 2, 7)?;
//! let model = Transition::random(config, 1)?;
//! let observed = Tensor::zeros((1, 2, 8, 8, 4), DType::F32, &Device::Cpu)?;
//! let between = Tensor::zeros((1, 7), DType::F32, &Device::Cpu)?;
//! let model = model.pack()?;
//! let sampler = &model.config().sampler;
//! let mut rollout = Rollout::new(&model, sampler, &observed, Some(&between), 7)?;
//! let action = Tensor::zeros((1, 7), DType::F32, &Device::Cpu)?;
//! for _ in 0..3 {
//!     assert_eq!(rollout.next(&action)?.dims(), [1, 8, 8, 4]);
//! }
//! # Ok(())
//! # }
//! ```

mod position;
mod prepared;
pub(crate) mod settings;
pub(crate) mod values;
mod window;

use std::sync::Arc;

use candle_core::Tensor;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::transition::{Batched, LoadedTransition};
use crate::{Error, Result};
pub use position::Position;
pub use prepared::Prepared;
pub use settings::{Sampler, shift_time};
pub use values::Observed;
use window::Window;

/// What [`Rollout::next_given`] takes instead of what a prediction has by itself; by default nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Given<'a> {
    /// Noise that the new frame starts from, (candidates, H, W, C), or (1, H, W, C) for all of them; else it comes
    /// from the seed.
    pub noise: Option<&'a Tensor>,
    /// The action that leads on from the new frame, (candidates, A), or (1, A) for all of them: that of the next step.
    /// Under [`ActionAlignment::WithFrame`](crate::transition::ActionAlignment::WithFrame) it is fed with the frame, as
    /// in training, where every frame carries its own action; without it the last action is held. Under the other
    /// alignment it is not used.
    pub own_action: Option<&'a Tensor>,
}

/// Where the noise of a prediction comes from: that of its step k is number `first_step` + k of `seed`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Noise {
    /// The seed.
    pub seed: u64,
    /// Predictions that were made from this seed before: a rollout that is taken up again goes on as if it had never
    /// been interrupted.
    pub first_step: usize,
}

/// A prediction in progress.
///
/// Equal seeds and inputs give equal bytes: the noise of step k depends on the seed and k only.
#[derive(Clone, Debug)]
pub struct Rollout<'m> {
    model: &'m LoadedTransition,
    sampler: Sampler,
    window: Window,
    /// Of all candidates, or of each row of a batch.
    noise: Arc<[Noise]>,
    /// Predictions made so far.
    steps_taken: usize,
    /// Candidates that are predicted side by side.
    candidates: usize,
}

impl<'m> Rollout<'m> {
    /// Starts from observed latents `context` (1, T, H, W, C), oldest first, T at least 1.
    ///
    /// `actions` (T - 1, A) are those between them, row i leading from frame i to the next; with a
    /// single frame there are none. Only the last `max_frames - 1` frames are used. Nothing is
    /// computed yet.
    ///
    /// # Errors
    /// If shapes do not fit the model, or a value is not finite.
    pub fn new(
        model: &'m LoadedTransition,
        sampler: &Sampler,
        context: &Tensor,
        actions: Option<&Tensor>,
        seed: u64,
    ) -> Result<Self> {
        if !matches!(context.dims(), [1, ..]) {
            return Err(Error::Shape {
                what: "the context",
                expected: "(1, T, H, W, C), T >= 1".into(),
                found: context.dims().to_vec(),
            });
        }
        let actions = actions.map(|actions| actions.unsqueeze(0)).transpose()?;
        let noise = Noise {
            seed,
            first_step: 0,
        };
        Self::batch(model, sampler, context, actions.as_ref(), &[noise])
    }

    /// Starts B rollouts that go on side by side, each from a context, actions and noise of its own: `context`
    /// (B, T, H, W, C) and `actions` (B, T - 1, A), else as [`Rollout::new`]. Each row is computed as it would be alone.
    ///
    /// # Errors
    /// If shapes do not fit the model or the number of `noise`s, or a value is not finite.
    pub fn batch(
        model: &'m LoadedTransition,
        sampler: &Sampler,
        context: &Tensor,
        actions: Option<&Tensor>,
        noise: &[Noise],
    ) -> Result<Self> {
        sampler.validate()?;
        let window = Window::new(model, context, actions, sampler.context_tau)?;
        let candidates = context.dim(0)?;
        if noise.len() != candidates {
            let reason = format!("{} for a batch of {candidates}", noise.len());
            return Err(Error::config("noise", reason));
        }
        Ok(Self {
            model,
            sampler: sampler.clone(),
            window,
            noise: noise.into(),
            steps_taken: 0,
            candidates,
        })
    }

    /// Computes what the context contributes to predictions, as far as it does not depend on
    /// actions to come. Predictions do so by themselves; this is for clones to share it.
    ///
    /// # Errors
    /// If the model fails.
    pub fn prepare(&mut self) -> Result<()> {
        self.window.prepare(self.model)
    }

    /// `n` candidates that go on from here side by side, each with actions of its own. They share
    /// the context that was prepared, and the noise of every step.
    ///
    /// # Errors
    /// If `n` is 0, or this already is several candidates.
    pub fn candidates(&self, n: usize) -> Result<Self> {
        if n == 0 || self.candidates != 1 {
            let reason = format!("{n} from {}, expected at least 1 from 1", self.candidates);
            return Err(Error::config("candidates", reason));
        }
        Ok(Self {
            candidates: n,
            ..self.clone()
        })
    }

    /// One candidate for each of the `noise`s, which goes on from here under it.
    ///
    /// # Errors
    /// If there is none, or this already is several candidates.
    pub fn candidates_under(&self, noise: &[Noise]) -> Result<Self> {
        Ok(Self {
            noise: noise.into(),
            ..self.candidates(noise.len())?
        })
    }

    /// The newest latent, observed or predicted: (H, W, C).
    ///
    /// # Errors
    /// If this is several candidates.
    pub fn newest(&self) -> Result<Tensor> {
        let c = self.model.config();
        let shape = [c.latent_height, c.latent_width, c.channels];
        let last = self.window.last_frame()?;
        if last.batch() != 1 {
            let reason = format!("the newest latent of {} was asked for", last.batch());
            return Err(Error::config("candidates", reason));
        }
        LoadedTransition::tensor_here(&last, &shape)
    }

    /// How frames are integrated.
    pub fn sampler(&self) -> &Sampler {
        &self.sampler
    }

    /// Length A of a model action.
    pub fn action_dim(&self) -> usize {
        self.model.config().action_dim
    }

    /// Number of predictions made so far: k of the one last returned.
    pub fn steps_taken(&self) -> usize {
        self.steps_taken
    }

    /// Predicts where `action` (candidates, A) leads from the last frame: (candidates, H, W, C), if it continues
    /// thereafter. The prediction is part of the context of the next one.
    ///
    /// # Errors
    /// If the shape does not fit, or an action is not finite.
    // Not an iterator: each step needs an action, and can fail.
    #[allow(clippy::should_implement_trait)]
    pub fn next(&mut self, action: &Tensor) -> Result<Tensor> {
        self.next_given(action, Given::default())
    }

    /// As [`Rollout::next`], with noise or the new frame's own action from outside: to compare with another
    /// implementation, or where a whole sequence of actions is known.
    ///
    /// # Errors
    /// If a shape does not fit, or a value is not finite.
    pub fn next_given(&mut self, action: &Tensor, given: Given<'_>) -> Result<Tensor> {
        let c = self.model.config();
        let grid = [c.latent_height, c.latent_width, c.channels];
        let actions = [c.action_dim];
        let action = self.read("the action", action, &actions, false)?;
        let noise = match given.noise {
            Some(noise) => self.read("the noise", noise, &grid, true)?,
            None => self.noise()?,
        };
        let own = given
            .own_action
            .map(|own| self.read("the new frame's own action", own, &actions, true))
            .transpose()?;
        self.window.push_action(action);
        self.window.make_room(c.max_frames);
        let clean = self.integrate(noise, own)?;
        let shape = [self.candidates, grid[0], grid[1], grid[2]];
        let tensor = LoadedTransition::tensor_here(&clean, &shape)?;
        self.window.push_frame(clean);
        self.steps_taken += 1;
        Ok(tensor)
    }

    /// The values of `tensor`, which is (candidates, rest..), or (1, rest..) if it may be `shared`.
    fn read(
        &self,
        what: &'static str,
        tensor: &Tensor,
        rest: &[usize],
        shared: bool,
    ) -> Result<Batched> {
        match tensor.dims() {
            [n, found @ ..] if found == rest && (*n == self.candidates || (shared && *n == 1)) => {
                self.model.hold_finite(what, tensor)
            }
            found => Err(Error::Shape {
                what,
                expected: format!(
                    "{:?}{}",
                    [&[self.candidates], rest].concat(),
                    if shared { ", or for a batch of 1" } else { "" }
                ),
                found: found.to_vec(),
            }),
        }
    }

    /// Euler steps of the new frame from `noise`.
    fn integrate(&mut self, noise: Batched, own: Option<Batched>) -> Result<Batched> {
        let n = self.candidates;
        let mut x = noise.expanded(n)?;
        drop(noise);
        let previous = self.window.last_frame()?.expanded(n)?;
        let action = self.window.action_of_new_frame(self.model, own)?;
        let action = action.expanded(n)?;
        let levels = self.sampler.levels();
        let taus: Vec<Vec<f32>> = levels.iter().map(|tau| vec![*tau as f32; n]).collect();
        // The last level is the clean frame's, at which nothing is computed.
        debug_assert_eq!(taus.len(), self.sampler.steps + 1);
        let steps = taus.get(..self.sampler.steps).unwrap_or(&taus);
        let mut passes = self.window.passes(self.model, steps, &action)?;
        for (from, to) in levels.iter().zip(levels.iter().skip(1)) {
            let output = passes.next(&x)?;
            self.model
                .euler_step(&mut x, &output, &previous, (*from, *to))?;
        }
        Ok(x)
    }

    /// Noise of this step: the same for all candidates, or that of each row.
    fn noise(&self) -> Result<Batched> {
        let c = self.model.config();
        let len = c.latent_height * c.latent_width * c.channels;
        let mut values = Vec::with_capacity(self.noise.len() * len);
        for noise in self.noise.iter() {
            let mut rng = ChaCha8Rng::seed_from_u64(noise.seed);
            rng.set_stream((noise.first_step + self.steps_taken) as u64);
            values.extend((0..len).map(|_| -> f32 { StandardNormal.sample(&mut rng) }));
        }
        self.model.hold("the noise", self.noise.len(), values)
    }
}

#[cfg(test)]
mod tests;
