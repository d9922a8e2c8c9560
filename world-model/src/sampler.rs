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
//! let sampler = &model.config().sampler;
//! let mut rollout = Rollout::new(&model, sampler, &observed, Some(&between), 7)?;
//! let action = Tensor::zeros((1, 7), DType::F32, &Device::Cpu)?;
//! for _ in 0..3 {
//!     assert_eq!(rollout.next(&action)?.dims(), [1, 8, 8, 4]);
//! }
//! # Ok(())
//! # }
//! ```

pub(crate) mod settings;
mod window;

use candle_core::{Device, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::transition::Transition;
use crate::{Error, Result};
pub use settings::{Sampler, shift_time};
use window::Window;

/// A prediction in progress.
///
/// Equal seeds and inputs give equal bytes: the noise of step k depends on the seed and k only.
#[derive(Clone, Debug)]
pub struct Rollout<'m> {
    model: &'m Transition,
    sampler: Sampler,
    window: Window,
    seed: u64,
    /// Predictions made so far.
    steps_taken: usize,
    /// Candidates that are predicted side by side.
    candidates: usize,
}

impl<'m> Rollout<'m> {
    /// Starts from observed latents `context` (1, T, H, W, C), oldest first, T at least 1.
    ///
    /// `actions` (T - 1, A) are those between them, row i leading from frame i to the next; with a
    /// single frame there are none. Only the last `max_frames - 1` frames are used.
    ///
    /// # Errors
    /// If shapes do not fit the model, or a value is not finite.
    pub fn new(
        model: &'m Transition,
        sampler: &Sampler,
        context: &Tensor,
        actions: Option<&Tensor>,
        seed: u64,
    ) -> Result<Self> {
        sampler.validate()?;
        let mut window = Window::new(model, context, actions, sampler.context_tau)?;
        window.prepare(model)?;
        Ok(Self {
            model,
            sampler: sampler.clone(),
            window,
            seed,
            steps_taken: 0,
            candidates: 1,
        })
    }

    /// `n` candidates that go on from here side by side, each with actions of its own. They share
    /// the context, computed once, and the noise of every step.
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

    /// Number of predictions made so far: k of the one last returned.
    pub fn steps_taken(&self) -> usize {
        self.steps_taken
    }

    /// Predicts where `action` (candidates, A) leads from the last frame: (candidates, H, W, C).
    /// The prediction is part of the context of the next one.
    ///
    /// # Errors
    /// If the shape does not fit, or an action is not finite.
    // Not an iterator: each step needs an action, and can fail.
    #[allow(clippy::should_implement_trait)]
    pub fn next(&mut self, action: &Tensor) -> Result<Tensor> {
        let expected = [self.candidates, self.model.config().action_dim];
        if action.dims() != expected {
            return Err(Error::Shape {
                what: "the action",
                expected: format!("{expected:?}"),
                found: action.dims().to_vec(),
            });
        }
        require_finite("the action", action)?;
        self.window.push_action(action.clone());
        self.window.make_room(self.model);
        self.window.prepare(self.model)?;
        let clean = self.integrate()?;
        self.window.push_frame(clean.clone());
        self.steps_taken += 1;
        Ok(clean)
    }

    /// Euler steps of the new frame.
    fn integrate(&self) -> Result<Tensor> {
        let n = self.candidates;
        let mut x = self.noise()?;
        let previous = expand(&self.window.last_frame()?, n)?.unsqueeze(1)?;
        let earlier = self.window.contexts();
        let action = expand(&self.window.action_of_new_frame(self.model)?, n)?.unsqueeze(1)?;
        let levels = self.sampler.levels();
        for (from, to) in levels.iter().zip(levels.iter().skip(1)) {
            let tau = Tensor::full(*from as f32, (n, 1), &Device::Cpu)?;
            let (output, _) = self.model.output_after(&earlier, &x, &tau, &action)?;
            let velocity = self.model.velocity(&output, &x, &tau, &previous)?;
            x = (x - (velocity * (from - to))?)?;
        }
        Ok(x.squeeze(1)?)
    }

    /// Noise of this step, the same for all candidates: (candidates, 1, H, W, C).
    fn noise(&self) -> Result<Tensor> {
        let c = self.model.config();
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(self.steps_taken as u64);
        let values: Vec<f32> = (0..c.latent_height * c.latent_width * c.channels)
            .map(|_| StandardNormal.sample(&mut rng))
            .collect();
        let shape = (1, c.latent_height, c.latent_width, c.channels);
        let noise = Tensor::from_vec(values, shape, &Device::Cpu)?;
        Ok(expand(&noise, self.candidates)?.unsqueeze(1)?)
    }
}

/// Repeats a batch of 1 to one of `n`.
fn expand(tensor: &Tensor, n: usize) -> Result<Tensor> {
    if tensor.dim(0)? == n {
        return Ok(tensor.clone());
    }
    let mut dims = tensor.dims().to_vec();
    if let Some(first) = dims.first_mut() {
        *first = n;
    }
    Ok(tensor.broadcast_as(dims)?.contiguous()?)
}

fn require_finite(what: &'static str, tensor: &Tensor) -> Result<()> {
    // A sum is finite only if every value is, unless huge values overflow, which is no better.
    let sum = tensor.abs()?.sum_all()?.to_scalar::<f32>()?;
    if sum.is_finite() {
        Ok(())
    } else {
        Err(Error::NotFinite { what })
    }
}

#[cfg(test)]
mod tests;
