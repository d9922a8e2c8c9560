use anyhow::{Context as _, Result, ensure};
use serde::{Deserialize, Serialize};
use wm_model::Fit;
use wm_zoo::WebDinoConfig;

use crate::{idm::IdmModelRecipe, recipe::recipe};

recipe! {
    /// Settings of encoder training, explained in `recipes/tiny/encoder.yaml`. The paper trains no encoder.
    #[expect(missing_docs, reason = "explained in the recipe")]
    pub struct EncoderRecipe in ["tiny"] of "encoder" {
        pub windows: usize,
        pub light: f64,
        pub dropout: f64,
        pub fit: Fit,
        pub model: EncoderModelRecipe,
        pub head: IdmModelRecipe,
    }
}

/// Shape of the encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipe")]
pub struct EncoderModelRecipe {
    pub name: Option<String>,
    pub image: usize,
    pub patch: usize,
    pub hidden: usize,
    pub depth: usize,
    pub heads: usize,
    pub mlp_ratio: f64,
}

impl EncoderRecipe {
    pub(super) fn check(&self) -> Result<()> {
        crate::recipe::check_batch(self.batch, self.micro_batch)?;
        ensure!(self.windows > 0, "windows is 0, expected at least 1");
        for (name, value) in [("dropout", self.dropout), ("light", self.light)] {
            ensure!(
                (0.0..1.0).contains(&value),
                "{name} is {value}, expected 0 up to 1"
            );
        }
        let own = &self.model;
        for ((name, whole), (by, part)) in [
            (("image", own.image), ("patch", own.patch)),
            (("hidden", own.hidden), ("heads", own.heads)),
        ] {
            ensure!(
                whole > 0 && part > 0 && whole.is_multiple_of(part),
                "model.{name} is {whole}, expected a multiple of model.{by}, {part}"
            );
        }
        Ok(())
    }

    /// Name of the latent space.
    pub(super) fn name(&self) -> Result<&str> {
        self.model.name.as_deref().context("model.name is open")
    }

    /// The encoder; loading checks it.
    #[must_use]
    pub fn config(&self) -> WebDinoConfig {
        let own = &self.model;
        WebDinoConfig {
            hidden_size: own.hidden,
            num_hidden_layers: own.depth,
            num_attention_heads: own.heads,
            mlp_ratio: own.mlp_ratio,
            image_size: own.image,
            patch_size: own.patch,
            use_mask_token: false,
            ..WebDinoConfig::default()
        }
    }
}
