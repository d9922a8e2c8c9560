//! What a training of an encoder leaves in its folder.

use std::path::Path;

use anyhow::Result;
use serde_json::json;
use wm_model::{Fit, PictureSize};
use wm_zoo::{WebDinoConfig, kinds::Kind};

use crate::{optimiser::Trained, trained_weights::trained_weights};

/// The weights' file in a model's folder.
pub const FILE: &str = "encoder.safetensors";
/// Metadata key of the [`WebDinoConfig`] (JSON), for a fine-tuning.
pub(super) const CONFIG_KEY: &str = "encoder_config";

/// The encoder's weights under the names of the kind `web-dino`.
pub(super) fn write_weights(
    folder: &Path,
    config: &WebDinoConfig,
    tensors: Vec<Trained<'_>>,
) -> Result<()> {
    let config = (CONFIG_KEY, config);
    let weights = trained_weights(&mut tensors.into_iter(), config, None)?;
    Ok(weights.write(folder.join(FILE))?)
}

/// The description of a model that is this encoder alone; `name` is that of its latent space, `trained_on` the size of the
/// camera's pictures.
pub(super) fn write_description(
    folder: &Path,
    config: &WebDinoConfig,
    name: &str,
    (fit, trained_on): (Fit, Option<PictureSize>),
) -> Result<()> {
    let description = json!({
        "name": name,
        "image": [config.image_size, config.image_size],
        "fit": fit,
        "trained_on": trained_on,
        "encoder": {"kind": Kind::WebDino.name(), "weights": FILE, "config": config},
    });
    crate::model_folder::write_description(folder, &description)
}
