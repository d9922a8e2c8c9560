use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};
use wm_motion::actions::{Accumulation, ActionEncoding, ActionSpace};
use wm_zoo::idm::{ConvolutionalIdmConfig, IdmConfig, IdmNetworkConfig};

use crate::recipe::recipe;

recipe! {
    /// Settings of inverse dynamics training, explained in `recipes/*/idm.yaml`.
    #[expect(missing_docs, reason = "explained in the recipes")]
    pub struct IdmRecipe in ["tiny", "paper"] of "idm" {
        pub dropout: f64,
        pub latent_noise: f64,
        pub longest: usize,
        pub last_goals: f64,
        pub model: IdmModelRecipe,
    }
}

/// The network of an inverse dynamics model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum IdmKind {
    /// The paper's transformer.
    Transformer,
    /// A small convolutional network.
    Convolutional,
}

/// Shape and conventions of the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct IdmModelRecipe {
    pub kind: IdmKind,
    pub horizon: usize,
    pub hidden: usize,
    pub width: usize,
    pub patch: Option<usize>,
    pub depth: usize,
    pub heads: usize,
    pub mlp: Option<usize>,
    pub frame_skip: usize,
    pub accumulation: Accumulation,
}

impl IdmModelRecipe {
    /// Encoding of the actions of `space` for the model.
    ///
    /// # Errors
    /// If they cannot be encoded.
    pub fn encoding(&self, space: &ActionSpace) -> Result<ActionEncoding> {
        let (skip, accumulation) = (self.frame_skip, self.accumulation);
        Ok(ActionEncoding::new(
            space.clone(),
            space.len(),
            skip,
            accumulation,
        )?)
    }

    /// With kind and sizes of another model.
    #[must_use]
    pub fn sized_as(&self, other: &IdmNetworkConfig) -> Self {
        let own = self.clone();
        match other {
            IdmNetworkConfig::Transformer(other) => Self {
                kind: IdmKind::Transformer,
                horizon: other.horizon,
                hidden: other.hidden,
                patch: Some(other.patch),
                depth: other.depth,
                heads: other.heads,
                mlp: other.mlp,
                ..own
            },
            IdmNetworkConfig::Convolutional(other) => Self {
                kind: IdmKind::Convolutional,
                horizon: other.horizon,
                hidden: other.hidden,
                width: other.width,
                ..own
            },
        }
    }

    /// The model for latents of this shape (rows, columns, channels) and actions of `encoding`.
    ///
    /// # Errors
    /// If the patches do not divide the latents; loading checks other sizes.
    pub fn config(
        &self,
        (rows, columns, channels): (usize, usize, usize),
        encoding: &ActionEncoding,
    ) -> Result<IdmNetworkConfig> {
        if self.kind == IdmKind::Convolutional {
            return Ok(IdmNetworkConfig::Convolutional(ConvolutionalIdmConfig {
                features: channels,
                horizon: self.horizon,
                grid: [rows, columns],
                width: self.width,
                hidden: self.hidden,
                actions: encoding.action_dim(),
            }));
        }
        // As published: 256 tokens per frame.
        let published = if rows > 16 { 2 } else { 1 };
        let patch = self.patch.unwrap_or(published);
        ensure!(
            patch > 0 && rows.is_multiple_of(patch) && columns.is_multiple_of(patch),
            "patch is {patch}, which does not divide latents of {rows}x{columns}"
        );
        Ok(IdmNetworkConfig::Transformer(IdmConfig {
            features: channels,
            horizon: self.horizon,
            patch,
            grid: [rows / patch, columns / patch],
            hidden: self.hidden,
            depth: self.depth,
            heads: self.heads,
            mlp: self.mlp,
            actions: encoding.action_dim(),
        }))
    }
}
