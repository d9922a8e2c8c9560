//! What a training of an adapter leaves in its folder.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use candle_core::DType;
use serde_json::{Value, json};
use wm_model::{
    LatentSpace,
    autoencoder::{MEAN, Normalisation, STD},
    weights::{Precision, WeightsBuilder},
};
use wm_zoo::{Checkpoint, PixelDecoderConfig, SvaeConfig, checkpoint::Average, kinds::Kind};

use crate::{
    model_folder::{description_of, write_description},
    optimiser::{Trained, Variables},
    trained_weights::trained_weights,
};

/// The weights' file in a model's folder.
pub const FILE: &str = "adapter.safetensors";
/// The file of mean and standard deviation of the latents.
pub const STATISTICS: &str = "stats.safetensors";
/// What names of the adapter's tensors begin with, as in the published checkpoints.
pub(super) const ADAPTER: &str = "adapter";
/// What names of the pixel decoder's tensors begin with.
pub(super) const PIXEL_DECODER: &str = "pixel_decoder";

/// The files of a training, and what they are about.
pub(super) struct Output<'a> {
    pub folder: &'a Path,
    pub svae: &'a SvaeConfig,
    pub pixel: &'a PixelDecoderConfig,
    /// Of the features.
    pub space: &'a LatentSpace,
}

impl Output<'_> {
    pub(super) fn weights(&self) -> PathBuf {
        self.folder.join(FILE)
    }

    /// Both networks, and their configurations as metadata.
    pub(super) fn write_weights(
        &self,
        averaged: &mut dyn Iterator<Item = Trained<'_>>,
    ) -> Result<()> {
        let config = ("adapter_config", self.svae);
        let mut weights = trained_weights(averaged, config, Some(self.space))?;
        weights.metadata("pixel_decoder_config", serde_json::to_string(self.pixel)?);
        Ok(weights.write(self.weights())?)
    }

    pub(super) fn write_statistics(&self, statistics: &Normalisation) -> Result<()> {
        let mut file = WeightsBuilder::new();
        for (name, values) in [(MEAN, &statistics.mean), (STD, &statistics.std)] {
            file.values(name, &[values.len()], values, Precision::F32);
        }
        Ok(file.write(self.folder.join(STATISTICS))?)
    }

    /// The description of a model: that of the encoder, with what this training has made.
    pub(super) fn write_description(&self, of_encoder: &Value, views: usize) -> Result<()> {
        let mut description = of_encoder.clone();
        let mut set = |key: &str, value: Value| {
            if let Some(fields) = description.as_object_mut() {
                fields.insert(key.to_owned(), value);
            }
        };
        set(
            "adapter",
            json!({"kind": Kind::Svae.name(), "weights": FILE, "config": self.svae}),
        );
        set("normalisation", json!(STATISTICS));
        set(
            "decoder",
            json!({"kind": Kind::Pixel.name(), "weights": FILE, "config": self.pixel}),
        );
        if views > 1 {
            set("views", json!(views));
        }
        write_description(self.folder, &description)
    }
}

/// What of the description in `folder` is about its encoder, under the name `name` and with absolute paths.
pub(super) fn encoder_of(folder: &Path, name: &str) -> Result<Value> {
    let mut description = description_of(folder)?;
    if let Some(parts) = description.as_object_mut() {
        parts.retain(|part, _| {
            ["image", "fit", "trained_on", "dtype", "encoder"].contains(&part.as_str())
        });
        parts.insert("name".into(), json!(name));
    }
    Ok(description)
}

/// Has a training start from the weights of another one.
pub(super) fn start_from(checkpoint: &Checkpoint, variables: &Variables) -> Result<()> {
    let parts = [(ADAPTER, Kind::Svae), (PIXEL_DECODER, Kind::Pixel)]
        .map(|(part, kind)| (part, kind.weights(checkpoint, Average::Ema)));
    for parameter in variables.parameters(|_| 0)? {
        let name = &parameter.name;
        let found = parts.iter().find_map(|(part, weights)| {
            let rest = name.strip_prefix(part)?.strip_prefix('.')?;
            Some((weights, rest))
        });
        let (weights, rest) = found.with_context(|| format!("`{name}` is of no network"))?;
        let shape = weights.shape(rest);
        ensure!(
            shape == Some(&parameter.shape),
            "{}: `{name}` is {shape:?}, expected {:?}",
            checkpoint.file(),
            parameter.shape
        );
        let values = weights.tensor(rest, DType::F32)?.flatten_all()?.to_vec1()?;
        variables.assign(std::iter::once(Trained {
            name,
            shape: &parameter.shape,
            values: &values,
        }))?;
    }
    Ok(())
}
