//! Random weights for a model folder, to try nodes, transport and speed with before there are trained ones.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use wm_model::transition::{Initialisation, Parameter};
use wm_model::weights::{Precision as Stored, WeightsBuilder};

use super::{Description, FILE, Part};
use crate::kinds::{DitConfig, Kind, build_dit, parse};
use crate::loader::Requested;
use crate::success_probe::SuccessProbe;
use crate::svae::Svae;
use crate::vit::SiglipText;
use crate::{Engine, Loader, Result};

use super::decoder::DecoderConfig;
use super::encoder::EncoderConfig;

/// Writes every weight file that the `model.json` in `folder` names and that is not there, as safetensors: values such
/// that activations neither vanish nor overflow, the same for the same `seed`. Gives the files written.
///
/// # Errors
/// If the description is not valid, or a file cannot be written.
pub fn write_random_weights(folder: &Path, seed: u64) -> Result<Vec<PathBuf>> {
    let description = Description::read(&folder.join(FILE))?;
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
    for (path, file) in &files {
        file.write(path)?;
    }
    Ok(files.into_keys().collect())
}

fn parts(description: &Description) -> Vec<Part> {
    let mut parts = vec![description.encoder.clone(), description.transition.part()];
    parts.extend(description.adapter.clone());
    if let Some(decoder) = &description.decoder {
        parts.push(decoder.part());
        parts.extend(decoder.adapter.clone());
    }
    if let Some(probe) = &description.probe {
        parts.extend([probe.part(), probe.text.part()]);
    }
    parts
}

fn requested(part: &Part, folder: &Path) -> Result<(Kind, Vec<Requested>)> {
    let (kind, config): (Kind, String) = (part.kind.parse()?, part.config.text(folder)?);
    let loader = Loader::skeleton(Engine::Candle);
    match kind {
        Kind::Dit => drop(build_dit(&parse::<DitConfig>(&config)?, &loader)?),
        Kind::Svae => drop(Svae::load(&parse(&config)?, &loader)?),
        Kind::SuccessProbe => drop(SuccessProbe::load(&parse(&config)?, &loader)?),
        Kind::Siglip2Text => drop(SiglipText::load(&parse(&config)?, &loader)?),
        _ => match DecoderConfig::parse(kind, &config) {
            Ok(config) => drop(config.load(&loader)?),
            Err(_) => drop(EncoderConfig::parse(kind, &config)?.load(&loader)?),
        },
    }
    Ok((kind, loader.requested()))
}

/// Products keep the size of what they are given, scales are near one, shifts near zero.
fn values(name: &str, shape: &[usize], seed: u64) -> Result<candle_core::Tensor> {
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
