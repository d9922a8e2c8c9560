use serde::{Deserialize, Serialize};
use wm_model::LatentSpace;
use wm_zoo::subgoals::SubgoalConfig;

use crate::recipe::recipe;

recipe! {
    /// Settings of the training of subgoals, explained in `recipes/*/subgoals.yaml`.
    #[expect(missing_docs, reason = "explained in the recipes")]
    pub struct SubgoalRecipe in ["tiny"] of "subgoals" {
        pub distances: Vec<usize>,
        pub longest: usize,
        pub frame_skip: Option<usize>,
        pub expected: f64,
        pub latent_noise: f64,
        pub model: SubgoalModelRecipe,
    }
}

/// Sizes of the network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct SubgoalModelRecipe {
    pub width: usize,
    pub hidden: usize,
}

impl SubgoalRecipe {
    /// The network for latents of `space`.
    #[must_use]
    pub fn config(&self, space: &LatentSpace, frame_skip: usize) -> SubgoalConfig {
        SubgoalConfig {
            features: space.channels,
            grid: [space.height, space.width],
            width: self.model.width,
            hidden: self.model.hidden,
            distances: self.distances.clone(),
            frame_skip,
        }
    }
}
