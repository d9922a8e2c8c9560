//! Random weights for a model folder, to try nodes, transport and speed with before there are trained ones.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use candle_core::{Device, Tensor};
use wm_model::Kernels;
use wm_model::autoencoder::{MEAN, STD};
use wm_model::transition::{Initialisation, Parameter};
use wm_model::weights::{Precision as Stored, WeightsBuilder};

use super::{Configuration, Description, FILE, Part, Statistics, TextPart, TransitionPart};
use crate::kinds::{DitConfig, Kind, build_dit, parse};
use crate::loader::Requested;
use crate::pooled_probe::config::PooledProbeConfig;
use crate::success_probe::SuccessProbe;
use crate::svae::{Svae, SvaeConfig};
use crate::vit::SiglipText;
use crate::{Error, Loader, Result};

use super::decoder::DecoderConfig;

/// Makes a folder that holds a `model.json` alone into a model: writes every file that the description names and that is
/// not there, but for a tokenizer, and gives those written. Weights are random, such that activations neither vanish nor overflow, and the
/// same for the same `seed`; the configuration of a published encoder or decoder is its published one; the latent's
/// statistics are mean 0 and standard deviation 1. Weights and statistics are safetensors, whatever their file is called.
///
/// # Errors
/// If the description is not valid, a configuration is missing that there is no published one for, or a file cannot be
/// written.
pub fn write_random_weights(folder: &Path, seed: u64) -> Result<Vec<PathBuf>> {
    let description = Description::read(&folder.join(FILE))?;
    let mut written = write_configurations(&description, folder)?;
    let mut files: BTreeMap<PathBuf, WeightsBuilder> = BTreeMap::new();
    for part in parts(&description) {
        let path = folder.join(&part.weights);
        if path.exists() {
            continue;
        }
        let (kind, tensors) = requested(&part, folder)?;
        let file = files.entry(path).or_default();
        // Where one file holds two networks, each lies under its authors' name for it.
        let prefix = match kind {
            Kind::Svae => "adapter.",
            Kind::Pixel => "pixel_decoder.",
            _ => "",
        };
        for Requested { name, shape } in tensors {
            let name = format!("{prefix}{name}");
            file.tensor(&name, &values(&name, &shape, seed)?, Stored::F32)?;
        }
    }
    if let Some(Statistics::File(name)) = &description.normalisation
        && !folder.join(name).exists()
    {
        let channels = channels(&description, folder)?;
        let file = files.entry(folder.join(name)).or_default();
        for (name, value) in [(MEAN, 0f32), (STD, 1.0)] {
            let values = Tensor::full(value, channels, &Device::Cpu)?;
            file.tensor(name, &values, Stored::F32)?;
        }
    }
    for (path, file) in &files {
        create_parent(path)?;
        file.write(path)?;
    }
    written.extend(files.into_keys());
    Ok(written)
}

/// Writes the published configurations of those parts whose own is not there.
fn write_configurations(description: &Description, folder: &Path) -> Result<Vec<PathBuf>> {
    let mut written = Vec::new();
    for part in parts(description) {
        let Configuration::File(name) = &part.config else {
            continue;
        };
        let path = folder.join(name);
        let kind: Kind = part.kind.parse()?;
        let Some(config) = kind.published_config().filter(|_| !path.exists()) else {
            continue;
        };
        create_parent(&path)?;
        std::fs::write(&path, format!("{config:#}\n")).map_err(|error| Error::io(&path, error))?;
        written.push(path);
    }
    Ok(written)
}

fn create_parent(path: &Path) -> Result<()> {
    match path.parent() {
        Some(folder) => std::fs::create_dir_all(folder).map_err(|error| Error::io(folder, error)),
        None => Ok(()),
    }
}

/// Channels of the latents.
fn channels(description: &Description, folder: &Path) -> Result<usize> {
    if let Some(adapter) = &description.adapter {
        return Ok(parse::<SvaeConfig>(&adapter.config.text(folder)?)?.latent);
    }
    let encoder = &description.encoder;
    let (kind, config): (Kind, String) = (encoder.kind.parse()?, encoder.config.text(folder)?);
    let [_, _, channels] = kind.encoder(&config)?.features(description.image)?;
    Ok(channels)
}

fn parts(description: &Description) -> Vec<Part> {
    let mut parts = vec![description.encoder.clone()];
    parts.extend(description.transition.as_ref().map(TransitionPart::part));
    parts.extend(description.adapter.clone());
    if let Some(decoder) = &description.decoder {
        parts.push(decoder.part());
        parts.extend(decoder.adapter.clone());
    }
    if let Some(probe) = &description.probe {
        parts.push(probe.part());
        parts.extend(probe.text.as_ref().map(TextPart::part));
    }
    parts
}

fn requested(part: &Part, folder: &Path) -> Result<(Kind, Vec<Requested>)> {
    let (kind, config): (Kind, String) = (part.kind.parse()?, part.config.text(folder)?);
    let loader = Loader::skeleton(Kernels::Candle);
    match kind {
        Kind::Dit => drop(build_dit(&parse::<DitConfig>(&config)?, &loader)?),
        Kind::Svae => drop(Svae::load(&parse(&config)?, &loader)?),
        Kind::SuccessProbe => drop(SuccessProbe::load(&parse(&config)?, &loader)?),
        Kind::LinearProbe | Kind::TemporalProbe | Kind::ProgressProbe => {
            drop(PooledProbeConfig::parse(kind, &config)?.load(&loader)?);
        }
        Kind::Siglip2Text => drop(SiglipText::load(&parse(&config)?, &loader)?),
        _ => match DecoderConfig::parse(kind, &config) {
            Ok(config) => drop(config.load(&loader)?),
            Err(_) => drop(kind.encoder(&config)?.load(&loader)?),
        },
    }
    Ok((kind, loader.requested()))
}

/// Products keep the size of what they are given, scales are near one, shifts near zero.
fn values(name: &str, shape: &[usize], seed: u64) -> Result<Tensor> {
    let inputs: usize = shape.iter().skip(1).product();
    let deviation = match shape.len() {
        0 | 1 => 0.1,
        _ => 1.0 / (inputs as f64).sqrt(),
    };
    let parameter = Parameter {
        name: name.to_owned(),
        shape: shape.to_vec(),
        initialisation: Initialisation::Normal(deviation),
    };
    let noise = parameter.initial(seed)?;
    let is_scale = shape.len() == 1 && !name.ends_with("bias");
    Ok(if is_scale { (noise + 1.0)? } else { noise })
}

#[cfg(test)]
mod tests {
    use serde_json::json;
    use wm_model::Compute;

    use super::super::DescribedFolder;
    use super::super::tests::adapted;
    use super::*;

    #[test]
    fn everything_but_the_description_may_be_missing() {
        let folder = tempfile::tempdir().unwrap();
        let mut model = adapted();
        model["encoder"]["weights"] = json!("web-dino/model.safetensors");
        model["normalisation"] = json!("stats.safetensors");
        std::fs::write(folder.path().join(FILE), model.to_string()).unwrap();
        let written = write_random_weights(folder.path(), 1).unwrap();
        let expected = [
            "dit.safetensors",
            "stats.safetensors",
            "svae.safetensors",
            "web-dino/model.safetensors",
        ];
        assert_eq!(written, expected.map(|file| folder.path().join(file)));
        let model = DescribedFolder::open(folder.path()).unwrap();
        model.world_model(&Compute::default()).unwrap();
        // Nothing is written twice.
        assert!(write_random_weights(folder.path(), 2).unwrap().is_empty());
    }

    #[test]
    fn a_published_encoder_is_configured_as_it_was_published() {
        let folder = tempfile::tempdir().unwrap();
        let mut model = adapted();
        model["encoder"]["config"] = json!("web-dino/config.json");
        model["adapter"]["config"] = json!("svae.json");
        std::fs::write(folder.path().join(FILE), model.to_string()).unwrap();
        let description = Description::read(&folder.path().join(FILE)).unwrap();
        let path = folder.path().join("web-dino/config.json");
        let written = write_configurations(&description, folder.path()).unwrap();
        assert_eq!(written, std::slice::from_ref(&path));
        let config: crate::vit::WebDinoConfig =
            parse(&std::fs::read_to_string(&path).unwrap()).unwrap();
        assert_eq!(config, crate::vit::WebDinoConfig::vit_large());

        // One of the user's is kept, and of what comes in several sizes there is none to fill in.
        std::fs::write(&path, "{}").unwrap();
        let written = write_configurations(&description, folder.path()).unwrap();
        assert!(written.is_empty());
        let error = write_random_weights(folder.path(), 1)
            .unwrap_err()
            .to_string();
        assert!(error.contains("svae.json"), "{error}");
    }
}
