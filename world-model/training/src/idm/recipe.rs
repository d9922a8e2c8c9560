use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};
use wm_model::LatentSpace;
use wm_motion::actions::{Accumulation, ActionEncoding, ActionSpace};
use wm_zoo::idm::IdmConfig;

use crate::recipe::{Bundled, Optimisation, Span};

/// The recipes that are part of the program.
pub const RECIPES: Bundled = &[
    ("tiny", include_str!("../../recipes/tiny/idm.yaml")),
    ("paper", include_str!("../../recipes/paper/idm.yaml")),
];

/// Every number of a training of the inverse dynamics model; `recipes/*/idm.yaml` says what each is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the recipes say what each is")]
pub struct IdmRecipe {
    pub seed: u64,
    pub length: Span,
    pub validate_every: u64,
    pub checkpoint_seconds: u64,
    pub batch: usize,
    pub micro_batch: usize,
    pub dropout: f64,
    pub latent_noise: f64,
    pub model: IdmModelRecipe,
    pub optimisation: Optimisation,
}

/// Shape and conventions of the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the recipes say what each is")]
pub struct IdmModelRecipe {
    pub horizon: usize,
    pub patch: Option<usize>,
    pub hidden: usize,
    pub depth: usize,
    pub heads: usize,
    pub mlp: Option<usize>,
    pub frame_skip: usize,
    pub accumulation: Accumulation,
}

impl IdmRecipe {
    /// What the actions of `space` become for the model.
    ///
    /// # Errors
    /// If they cannot be encoded.
    pub fn encoding(&self, space: &ActionSpace) -> Result<ActionEncoding> {
        let own = &self.model;
        let (skip, accumulation) = (own.frame_skip, own.accumulation);
        Ok(ActionEncoding::new(
            space.clone(),
            space.len(),
            skip,
            accumulation,
        )?)
    }

    /// The model for latents of `space` and actions of `encoding`.
    ///
    /// # Errors
    /// If the patches do not fit the latents; loading tells of other sizes.
    pub fn config(&self, space: &LatentSpace, encoding: &ActionEncoding) -> Result<IdmConfig> {
        let own = &self.model;
        // As published: 256 tokens a frame.
        let published = if space.height > 16 { 2 } else { 1 };
        let patch = own.patch.unwrap_or(published);
        ensure!(
            patch > 0 && space.height.is_multiple_of(patch) && space.width.is_multiple_of(patch),
            "model.patch is {patch}, which does not divide latents of {}x{}",
            space.height,
            space.width
        );
        Ok(IdmConfig {
            features: space.channels,
            horizon: own.horizon,
            patch,
            grid: [space.height / patch, space.width / patch],
            hidden: own.hidden,
            depth: own.depth,
            heads: own.heads,
            mlp: own.mlp,
            actions: encoding.action_dim(),
        })
    }
}
