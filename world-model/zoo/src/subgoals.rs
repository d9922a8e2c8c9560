//! Subgoals: latents between the present one and a goal, at growing distances.
//!
//! The network is the transition model's, over the frames goal, present, and the subgoals from the nearest to the
//! farthest. In place of an action, each subgoal has its distance from the present frame. It learns with hindsight goals:
//! later frames of the same episode. A subgoal farther away than the goal is the goal.

use candle_core::{DType, Device, Tensor};
use serde::{Deserialize, Serialize};
use wm_model::{
    LatentSpace, Weights,
    sampler::{Rollout, Sampler},
    transition::{LATENT_SPACE_KEY, LoadedTransition, Transition, TransitionConfig},
};

use crate::Result;
use crate::sizes::shape_error;

/// Metadata key of the [`SubgoalConfig`] (JSON).
pub const SUBGOALS_KEY: &str = "subgoals";

/// Frames before the first subgoal: the goal and the present one.
pub const GIVEN_FRAMES: usize = 2;
/// Values of a subgoal's condition.
pub const CONDITION_VALUES: usize = 1;
/// Subgoals at most.
const MOST: usize = 16;
/// Seed of the noise from which the expected subgoals are computed.
const EXPECTED_SEED: u64 = 0;

/// The distances of the subgoals.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SubgoalConfig {
    /// Distances of the subgoals from the present frame, in model steps, increasing.
    pub distances: Vec<usize>,
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

    /// Frames of the network.
    pub fn frames(&self) -> usize {
        GIVEN_FRAMES + self.distances.len()
    }
}

/// The condition of a subgoal `distance` model steps away.
pub fn condition(distance: usize) -> f32 {
    (1.0 + distance as f32).log2() / 4.0
}

/// How subgoals are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SubgoalSampling {
    /// The expected subgoals, in one step of the sampler: the same for the same inputs.
    #[default]
    Expected,
    /// A sample of those possible.
    Sampled {
        /// Seed of its noise.
        seed: u64,
        /// Euler steps of the sampler.
        steps: usize,
    },
}

impl SubgoalSampling {
    /// A sample by `seed` in this many Euler steps; the expected subgoals for one step.
    pub fn of(seed: u64, steps: usize) -> Self {
        match steps {
            0 | 1 => Self::Expected,
            steps => Self::Sampled { seed, steps },
        }
    }
}

/// A trained model of subgoals, written by `wm train subgoals`.
#[derive(Debug)]
pub struct TrainedSubgoals {
    network: LoadedTransition,
    config: SubgoalConfig,
    space: LatentSpace,
}

impl TrainedSubgoals {
    /// Loads the model.
    ///
    /// # Errors
    /// If a tensor or an entry of the metadata is missing, misshapen or unexpected.
    pub fn from_weights(weights: Weights) -> Result<Self> {
        let config: SubgoalConfig = weights.json(SUBGOALS_KEY)?;
        config.validate()?;
        let space: LatentSpace = weights.json(LATENT_SPACE_KEY)?;
        Self::of(Transition::from_weights(weights)?, config, space)
    }

    /// A model with seeded random weights, for tests and timing.
    ///
    /// # Errors
    /// If the configurations do not fit together.
    pub fn random(
        network: TransitionConfig,
        config: SubgoalConfig,
        space: LatentSpace,
        seed: u64,
    ) -> Result<Self> {
        config.validate()?;
        Self::of(Transition::random(network, seed)?, config, space)
    }

    fn of(network: Transition, config: SubgoalConfig, space: LatentSpace) -> Result<Self> {
        check(network.config(), &config, &space)?;
        Ok(Self {
            network: network.pack()?,
            config,
            space,
        })
    }

    /// Distances of the subgoals, in model steps.
    pub fn distances(&self) -> &[usize] {
        &self.config.distances
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
    /// If a latent has another shape, or a value is not finite.
    pub fn propose(
        &self,
        present: &Tensor,
        goal: &Tensor,
        sampling: SubgoalSampling,
    ) -> Result<Vec<Tensor>> {
        let (height, width, channels) = self.space.shape();
        for (what, latent) in [("the present latent", present), ("the goal", goal)] {
            if latent.dims() != [height, width, channels] {
                let expected = format!("({height}, {width}, {channels})");
                return Err(shape_error(what, expected, latent));
            }
        }
        let (seed, steps) = match sampling {
            SubgoalSampling::Expected => (EXPECTED_SEED, 1),
            SubgoalSampling::Sampled { seed, steps } => (seed, steps),
        };
        let sampler = Sampler {
            steps,
            ..self.network.config().sampler.clone()
        };
        let context = Tensor::stack(&[goal, present], 0)?.unsqueeze(0)?;
        let between = Tensor::zeros((1, CONDITION_VALUES), DType::F32, &Device::Cpu)?;
        let mut rollout = Rollout::new(&self.network, &sampler, &context, Some(&between), seed)?;
        let distances = self.config.distances.iter();
        distances
            .map(|distance| {
                let condition = Tensor::new(&[[condition(*distance)]], &Device::Cpu)?;
                Ok(rollout.next(&condition)?.squeeze(0)?)
            })
            .collect()
    }
}

fn check(network: &TransitionConfig, config: &SubgoalConfig, space: &LatentSpace) -> Result<()> {
    let own = (
        network.latent_height,
        network.latent_width,
        network.channels,
    );
    let reason = if own != space.shape() {
        format!(
            "the network takes latents of {own:?}, the space has {:?}",
            space.shape()
        )
    } else if network.action_dim != CONDITION_VALUES {
        format!(
            "the network takes conditions of {} values, expected {CONDITION_VALUES}",
            network.action_dim
        )
    } else if network.max_frames < config.frames() {
        format!(
            "{} subgoals need {} frames, the network takes {}",
            config.distances.len(),
            config.frames(),
            network.max_frames
        )
    } else {
        return Ok(());
    };
    Err(wm_model::Error::config("subgoals", reason).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn space() -> LatentSpace {
        LatentSpace {
            name: "small".to_owned(),
            hash: String::new(),
            height: 4,
            width: 4,
            channels: 4,
        }
    }

    fn network(distances: usize) -> TransitionConfig {
        let preset = TransitionConfig::preset("tiny", (4, 4, 4), 2, CONDITION_VALUES).unwrap();
        TransitionConfig {
            hidden: 32,
            depth: 2,
            heads: 2,
            max_frames: GIVEN_FRAMES + distances,
            ..preset
        }
    }

    fn of(network: TransitionConfig, distances: &[usize]) -> Result<TrainedSubgoals> {
        let config = SubgoalConfig {
            distances: distances.to_vec(),
        };
        TrainedSubgoals::random(network, config, space(), 3)
    }

    fn waves(pitch: f32) -> Tensor {
        let values: Vec<f32> = (0..64).map(|i| (i as f32 * pitch).sin()).collect();
        Tensor::from_vec(values, (4, 4, 4), &Device::Cpu).unwrap()
    }

    fn values(latents: &[Tensor]) -> Vec<Vec<f32>> {
        let each = latents.iter();
        each.map(|latent| latent.flatten_all().unwrap().to_vec1().unwrap())
            .collect()
    }

    #[test]
    fn subgoals_depend_on_present_goal_and_seed_alone() {
        let model = of(network(3), &[1, 2, 4]).unwrap();
        let (present, goal) = (waves(0.3), waves(0.7));
        let propose = |sampling| values(&model.propose(&present, &goal, sampling).unwrap());
        for sampling in [
            SubgoalSampling::Expected,
            SubgoalSampling::Sampled { seed: 5, steps: 2 },
        ] {
            let all = propose(sampling);
            assert_eq!(all.len(), 3);
            assert_eq!(propose(sampling), all);
            assert!(all.iter().flatten().all(|value| value.is_finite()));
        }
        let other = model.propose(&present, &waves(0.5), SubgoalSampling::Expected);
        assert_ne!(values(&other.unwrap()), propose(SubgoalSampling::Expected));
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let refused = |found: Result<TrainedSubgoals>| found.unwrap_err().to_string();
        let error = refused(of(network(1), &[1, 2]));
        assert!(error.contains("2 subgoals need 4 frames"), "{error}");
        let error = refused(of(network(2), &[2, 1]));
        assert!(error.contains("[2, 1]"), "{error}");
        let wide = TransitionConfig::preset("tiny", (4, 4, 8), 2, CONDITION_VALUES).unwrap();
        let error = refused(of(wide, &[1]));
        assert!(error.contains("(4, 4, 8)"), "{error}");
        let steered = TransitionConfig::preset("tiny", (4, 4, 4), 2, 7).unwrap();
        let error = refused(of(steered, &[1]));
        assert!(error.contains("7 values"), "{error}");
        let model = of(network(1), &[1]).unwrap();
        let nan = (waves(0.3) * f64::NAN).unwrap();
        let error = model.propose(&nan, &waves(0.2), SubgoalSampling::Expected);
        assert!(error.unwrap_err().to_string().contains("finite"));
    }
}
