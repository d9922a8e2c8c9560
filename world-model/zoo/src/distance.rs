//! A learnt distance: how many model steps demonstrations took from one latent to another.
//!
//! Quantiles of that number, by regression on pairs of frames of an episode (pinball loss). Frames of different episodes
//! are taken as at least the longest distance apart. The network is the convolutional one of inverse dynamics models,
//! which sees both latents as channels of the same place.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_model::{Kernels, LatentSpace, Weights, transition::LATENT_SPACE_KEY};

use crate::idm::{ConvolutionalIdm, ConvolutionalIdmConfig};
use crate::layers::Dropout;
use crate::loader::OfWeights;
use crate::{Loader, Result};

/// Metadata key of the [`DistanceConfig`] (JSON).
pub const DISTANCE_KEY: &str = "distance";

/// Sizes of the network, and what its outputs are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DistanceConfig {
    /// Channels of the latents.
    pub features: usize,
    /// Rows and columns of the latents.
    pub grid: [usize; 2],
    /// Channels of the first convolutions.
    pub width: usize,
    /// Width of the layer before the last.
    pub hidden: usize,
    /// The learnt quantiles, each between 0 and 1, increasing.
    pub quantiles: Vec<f64>,
    /// The longest distance, in model steps; farther counts as this.
    pub longest: f64,
}

impl DistanceConfig {
    fn validate(&self) -> Result<()> {
        let wrong = |name, reason: String| Err(wm_model::Error::config(name, reason).into());
        let increases = self.quantiles.is_sorted_by(|a, b| a < b);
        let between = |quantile: &f64| *quantile > 0.0 && *quantile < 1.0;
        if self.quantiles.is_empty() || !increases || !self.quantiles.iter().all(between) {
            let reason = format!("{:?}, expected increasing ones from 0 to 1", self.quantiles);
            return wrong("distance.quantiles", reason);
        }
        if !(self.longest.is_finite() && self.longest >= 1.0) {
            let reason = format!("{}, expected at least 1 model step", self.longest);
            return wrong("distance.longest", reason);
        }
        Ok(())
    }

    /// The network's value of a distance \[model steps\]: 0 to 1, on a logarithmic scale.
    pub fn value(&self, steps: f64) -> f64 {
        steps.clamp(0.0, self.longest).ln_1p() / self.longest.ln_1p()
    }

    /// The distance \[model steps\] of a value of the network.
    pub fn steps(&self, value: f64) -> f64 {
        (value.clamp(0.0, 1.0) * self.longest.ln_1p()).exp_m1()
    }

    fn network(&self) -> ConvolutionalIdmConfig {
        ConvolutionalIdmConfig {
            features: self.features,
            horizon: 1,
            grid: self.grid,
            width: self.width,
            hidden: self.hidden,
            actions: self.quantiles.len(),
        }
    }
}

/// The network of a learnt distance.
#[derive(Clone, Debug)]
pub struct DistanceNetwork {
    config: DistanceConfig,
    network: ConvolutionalIdm,
}

impl DistanceNetwork {
    /// Loads the network.
    ///
    /// # Errors
    /// If the configuration is invalid; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &DistanceConfig, loader: &Loader<'_>) -> Result<Self> {
        config.validate()?;
        Ok(Self {
            network: ConvolutionalIdm::load(&config.network(), loader)?,
            config: config.clone(),
        })
    }

    /// The configuration.
    pub fn config(&self) -> &DistanceConfig {
        &self.config
    }

    /// [`DistanceConfig::value`] of each quantile (B, Q) of the distances of pairs of latents (B, 2, h, w, C), from the
    /// first to the second, normalised.
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn values(&self, pairs: &Tensor) -> Result<Tensor> {
        let values = self.network.forward_dropping(pairs, &mut Dropout::none())?;
        Ok(values.squeeze(1)?)
    }
}

/// A learnt distance, written by `wm train distance`.
#[derive(Clone, Debug)]
pub struct TrainedDistance {
    network: DistanceNetwork,
    space: LatentSpace,
}

impl TrainedDistance {
    /// Loads the distance.
    ///
    /// # Errors
    /// If a tensor or an entry of the metadata is missing, misshapen or unexpected.
    pub fn from_weights(weights: Weights) -> Result<Self> {
        let config: DistanceConfig = weights.json(DISTANCE_KEY)?;
        let loader = OfWeights(&weights);
        let network = DistanceNetwork::load(&config, &Loader::supplied(&loader, Kernels::Cpu))?;
        let space = weights.json(LATENT_SPACE_KEY)?;
        weights.finish()?;
        Ok(Self { network, space })
    }

    /// The space of the latents.
    pub fn space(&self) -> &LatentSpace {
        &self.space
    }

    /// The learnt quantiles.
    pub fn quantiles(&self) -> &[f64] {
        &self.network.config.quantiles
    }

    /// The longest distance \[model steps\].
    pub fn longest(&self) -> f64 {
        self.network.config.longest
    }

    /// Distances \[model steps\] from the first to the second latent of each pair (B, 2, h, w, C): the quantiles of each
    /// pair, in increasing order.
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn steps(&self, pairs: &Tensor) -> Result<Vec<Vec<f64>>> {
        let values = self.network.values(pairs)?.to_vec2::<f32>()?;
        let config = &self.network.config;
        let of_pair = |values: Vec<f32>| {
            let steps = values
                .into_iter()
                .map(|value| config.steps(f64::from(value)));
            let mut steps: Vec<f64> = steps.collect();
            // Separately learnt quantiles may cross.
            steps.sort_by(f64::total_cmp);
            steps
        };
        Ok(values.into_iter().map(of_pair).collect())
    }
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device};
    use proptest::prelude::*;

    use super::*;

    fn config() -> DistanceConfig {
        DistanceConfig {
            features: 4,
            grid: [4, 6],
            width: 8,
            hidden: 16,
            quantiles: vec![0.1, 0.5, 0.9],
            longest: 32.0,
        }
    }

    proptest! {
        #[test]
        fn a_value_keeps_its_distance(steps in 0.0..32.0_f64) {
            let config = config();
            let value = config.value(steps);
            prop_assert!((0.0..=1.0).contains(&value));
            prop_assert!((config.steps(value) - steps).abs() < 1e-9 * (1.0 + steps));
        }
    }

    #[test]
    fn farther_than_the_longest_is_the_longest() {
        assert_eq!(config().value(1e9), 1.0);
        assert!((config().steps(7.0) - 32.0).abs() < 1e-9);
    }

    #[test]
    fn each_pair_has_its_quantiles() {
        let network = DistanceNetwork::load(&config(), &Loader::skeleton(Kernels::Candle)).unwrap();
        let pairs = |frames| Tensor::zeros((3, frames, 4, 6, 4), DType::F32, &Device::Cpu).unwrap();
        assert_eq!(network.values(&pairs(2)).unwrap().dims(), [3, 3]);
        let error = network.values(&pairs(3)).unwrap_err().to_string();
        assert!(error.contains("(B, 2, 4, 6, 4)"), "{error}");
    }

    #[test]
    fn unusable_configurations_are_named() {
        let refused = |config: DistanceConfig| {
            let loaded = DistanceNetwork::load(&config, &Loader::skeleton(Kernels::Candle));
            loaded.unwrap_err().to_string()
        };
        for quantiles in [vec![], vec![0.5, 0.5], vec![0.0, 0.5], vec![0.5, f64::NAN]] {
            let error = refused(DistanceConfig {
                quantiles,
                ..config()
            });
            assert!(error.contains("quantiles"), "{error}");
        }
        let error = refused(DistanceConfig {
            longest: f64::INFINITY,
            ..config()
        });
        assert!(error.contains("longest"), "{error}");
    }
}
