//! Subgoals: latents between the present one and a goal, at growing distances.
//!
//! A small convolutional network proposes all of them at once. It learns with hindsight goals: later frames of the same
//! episode. A subgoal farther away than the goal is the goal. With zeros in the place of noise, it gives the expected
//! subgoals; from noise, in several Euler steps of flow matching, a sample.

mod network;

use candle_core::{DType, Device, Tensor};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use serde::{Deserialize, Serialize};
use wm_model::{Kernels, LatentSpace, Weights, transition::LATENT_SPACE_KEY};

use crate::loader::OfWeights;
use crate::sizes::shape_error;
use crate::{Loader, Result};
pub use network::SubgoalNetwork;

/// Metadata key of the [`SubgoalConfig`] (JSON).
pub const SUBGOALS_KEY: &str = "subgoals";

/// Subgoals at most.
const MOST: usize = 16;

/// Sizes of the network, and what the subgoals are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SubgoalConfig {
    /// Channels of the latents.
    pub features: usize,
    /// Rows and columns of the latents.
    pub grid: [usize; 2],
    /// Channels at full size; twice as many at half and at a quarter of it.
    pub width: usize,
    /// Width of the layer that joins all places.
    pub hidden: usize,
    /// Distances of the subgoals from the present frame, in model steps, increasing.
    pub distances: Vec<usize>,
    /// Camera frames per model step.
    pub frame_skip: usize,
}

impl SubgoalConfig {
    /// Checks the distances.
    ///
    /// # Errors
    /// If there are none or too many, or they do not increase from 1.
    pub fn validate(&self) -> Result<()> {
        let first = std::iter::once(&0).chain(&self.distances);
        let increases = first.zip(&self.distances).all(|(a, b)| a < b);
        if increases && (1..=MOST).contains(&self.distances.len()) {
            return Ok(());
        }
        let reason = format!(
            "{:?}, expected 1 to {MOST} increasing numbers of model steps",
            self.distances
        );
        Err(wm_model::Error::config("subgoals.distances", reason).into())
    }
}

/// How subgoals are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SubgoalSampling {
    /// The expected subgoals: the same for the same inputs.
    #[default]
    Expected,
    /// A sample of those possible.
    Sampled {
        /// Seed of its noise.
        seed: u64,
        /// Euler steps.
        steps: usize,
    },
}

/// A trained model of subgoals, written by `wm train subgoals`.
#[derive(Clone, Debug)]
pub struct TrainedSubgoals {
    network: SubgoalNetwork,
    space: LatentSpace,
}

impl TrainedSubgoals {
    /// Loads the model.
    ///
    /// # Errors
    /// If a tensor or an entry of the metadata is missing, misshapen or unexpected.
    pub fn from_weights(weights: Weights) -> Result<Self> {
        let config: SubgoalConfig = weights.json(SUBGOALS_KEY)?;
        let loader = OfWeights(&weights);
        let network = SubgoalNetwork::load(&config, &Loader::supplied(&loader, Kernels::Cpu))?;
        let space: LatentSpace = weights.json(LATENT_SPACE_KEY)?;
        weights.finish()?;
        Ok(Self { network, space })
    }

    /// Distances of the subgoals, in model steps.
    pub fn distances(&self) -> &[usize] {
        &self.network.config().distances
    }

    /// The space of the latents.
    pub fn space(&self) -> &LatentSpace {
        &self.space
    }

    /// Camera frames per model step.
    pub fn frame_skip(&self) -> usize {
        self.network.config().frame_skip
    }

    /// The subgoals (h, w, C) on the way from `present` to `goal`, both (h, w, C), normalised, nearest first.
    ///
    /// # Errors
    /// If a latent has another shape.
    pub fn propose(
        &self,
        present: &Tensor,
        goal: &Tensor,
        sampling: SubgoalSampling,
    ) -> Result<Vec<Tensor>> {
        sample(&self.network, present, goal, sampling)
    }
}

/// The subgoals that `network` gives.
fn sample(
    network: &SubgoalNetwork,
    present: &Tensor,
    goal: &Tensor,
    sampling: SubgoalSampling,
) -> Result<Vec<Tensor>> {
    let config = network.config();
    let ([h, w], c, k) = (config.grid, config.features, config.distances.len());
    for (what, latent) in [("the present latent", present), ("the goal", goal)] {
        if latent.dims() != [h, w, c] {
            return Err(shape_error(what, format!("({h}, {w}, {c})"), latent));
        }
    }
    let way = (&present.unsqueeze(0)?, &goal.unsqueeze(0)?);
    let clean = |x: &Tensor, tau: f32| {
        let tau = Tensor::new(&[tau], &Device::Cpu)?;
        network.forward(way, (x, &tau))
    };
    let shape = (1, k, h, w, c);
    let subgoals = match sampling {
        SubgoalSampling::Expected => clean(&Tensor::zeros(shape, DType::F32, &Device::Cpu)?, 1.0)?,
        SubgoalSampling::Sampled { seed, steps } => {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let noise = (0..k * h * w * c).map(|_| StandardNormal.sample(&mut rng));
            let noise: Vec<f32> = noise.collect();
            let mut x = Tensor::from_vec(noise, shape, &Device::Cpu)?;
            let steps = steps.max(1);
            for step in (1..=steps).rev() {
                // The clean frames' share of the rest of the way grows to 1 in the last step.
                let found = clean(&x, step as f32 / steps as f32)?;
                x = (&x + ((found - &x)? / step as f64)?)?;
            }
            x
        }
    };
    (0..k)
        .map(|index| Ok(subgoals.get(0)?.get(index)?))
        .collect()
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::Supply;

    /// Weights that differ everywhere.
    #[derive(Default)]
    struct Waves(Cell<usize>);

    impl Supply for Waves {
        fn supply(&self, _: &str, shape: &[usize]) -> Result<Tensor> {
            let first = self.0.replace(self.0.get() + 7);
            let values =
                (0..shape.iter().product()).map(|i: usize| ((i + first) as f32).sin() * 0.1);
            Ok(Tensor::from_vec(
                values.collect::<Vec<_>>(),
                shape,
                &Device::Cpu,
            )?)
        }

        fn device(&self) -> Device {
            Device::Cpu
        }
    }

    fn config(grid: [usize; 2], distances: &[usize]) -> SubgoalConfig {
        SubgoalConfig {
            features: 4,
            grid,
            width: 8,
            hidden: 16,
            distances: distances.to_vec(),
            frame_skip: 2,
        }
    }

    fn network(config: &SubgoalConfig, kernels: Kernels) -> Result<SubgoalNetwork> {
        SubgoalNetwork::load(config, &Loader::supplied(&Waves::default(), kernels))
    }

    fn waves(grid: [usize; 2], pitch: f32) -> Tensor {
        let [h, w] = grid;
        let values: Vec<f32> = (0..h * w * 4).map(|i| (i as f32 * pitch).sin()).collect();
        Tensor::from_vec(values, (h, w, 4), &Device::Cpu).unwrap()
    }

    fn values(latents: &[Tensor]) -> Vec<Vec<f32>> {
        let each = latents.iter();
        each.map(|latent| latent.flatten_all().unwrap().to_vec1().unwrap())
            .collect()
    }

    #[test]
    fn subgoals_depend_on_present_goal_and_seed_alone() {
        // An odd grid too.
        for grid in [[8, 8], [5, 6]] {
            let model = network(&config(grid, &[1, 2, 4]), Kernels::Cpu).unwrap();
            let (present, goal) = (waves(grid, 0.3), waves(grid, 0.7));
            let propose = |sampling| values(&sample(&model, &present, &goal, sampling).unwrap());
            let expected = propose(SubgoalSampling::Expected);
            assert_eq!(expected.len(), 3);
            assert_eq!(expected[0].len(), present.elem_count());
            let sampled = |seed| propose(SubgoalSampling::Sampled { seed, steps: 3 });
            assert_eq!(sampled(1), sampled(1));
            assert_ne!(sampled(1), sampled(2));
            for other in [waves(grid, 0.5), present.clone()] {
                let found = sample(&model, &present, &other, SubgoalSampling::Expected);
                assert_ne!(values(&found.unwrap()), expected);
            }
        }
    }

    #[test]
    fn kernels_and_candle_agree() {
        let grid = [8, 8];
        let of = |kernels| {
            let model = network(&config(grid, &[1, 3]), kernels).unwrap();
            let (present, goal) = (waves(grid, 0.3), waves(grid, 0.7));
            let found = sample(&model, &present, &goal, SubgoalSampling::Expected);
            values(&found.unwrap()).concat()
        };
        for (a, b) in of(Kernels::Cpu).into_iter().zip(of(Kernels::Candle)) {
            assert!((a - b).abs() < 1e-4 * (1.0 + b.abs()), "{a} {b}");
        }
    }

    #[test]
    fn what_does_not_fit_is_named() {
        for distances in [&[][..], &[2, 1], &[0, 1]] {
            let error = network(&config([8, 8], distances), Kernels::Candle);
            let error = error.unwrap_err().to_string();
            assert!(error.contains("distances"), "{error}");
        }
        let model = network(&config([8, 8], &[1]), Kernels::Candle).unwrap();
        let (present, goal) = (waves([8, 8], 0.3), waves([8, 6], 0.7));
        let error = sample(&model, &present, &goal, SubgoalSampling::Expected);
        let error = error.unwrap_err().to_string();
        assert!(
            error.contains("the goal") && error.contains("(8, 8, 4)"),
            "{error}"
        );
    }
}
