use serde::{Deserialize, Serialize};
use wm_model::LatentSpace;
use wm_zoo::distance::DistanceConfig;

use crate::recipe::recipe;

recipe! {
    /// Settings of the training of a distance, explained in `recipes/*/distance.yaml`.
    #[expect(missing_docs, reason = "explained in the recipes")]
    pub struct DistanceRecipe in ["tiny"] of "distance" {
        pub quantiles: Vec<f64>,
        pub longest: usize,
        pub frame_skip: Option<usize>,
        pub latent_noise: f64,
        pub others: f64,
        pub same: f64,
        pub model: DistanceModelRecipe,
    }
}

/// Sizes of the network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct DistanceModelRecipe {
    pub width: usize,
    pub hidden: usize,
}

impl DistanceRecipe {
    /// The network for latents of `space`.
    #[must_use]
    pub fn config(&self, space: &LatentSpace) -> DistanceConfig {
        DistanceConfig {
            features: space.channels,
            grid: [space.height, space.width],
            width: self.model.width,
            hidden: self.model.hidden,
            quantiles: self.quantiles.clone(),
            longest: self.longest as f64,
        }
    }
}
