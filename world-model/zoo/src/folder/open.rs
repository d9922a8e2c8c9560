//! The parts of a folder: their files, held against what the description says of them.

use std::path::Path;
use std::sync::Arc;

use wm_model::LatentSpace;
use wm_model::autoencoder::{MEAN, Normalisation, STD};
use wm_model::trained_folder::TRANSITION_FILE;
use wm_model::transition::TransitionConfig;
use wm_motion::actions::ActionEncoding;

use super::decoder::DecoderConfig;
use super::description::{Description, Part, Statistics, TransitionPart};
use super::source::Source;
use super::{Dynamics, Opened, Pictures};
use crate::kinds::{DitConfig, EncoderConfig, Kind, build_transition, parse};
use crate::svae::{Svae, SvaeConfig};
use crate::{Checkpoint, Result};

pub(super) fn open_encoder(
    description: &Description,
    folder: &Path,
) -> Result<Opened<Arc<dyn EncoderConfig>>> {
    let source = Source::open("encoder", &description.encoder, folder)?;
    let config = source.kind.encoder(&source.config)?;
    let tensors = source.survey(|loader| config.load(loader))?;
    Ok(Opened {
        source,
        config,
        tensors,
    })
}

pub(super) fn open_adapter(
    part: Option<&Part>,
    folder: &Path,
    role: &'static str,
) -> Result<Option<Opened<SvaeConfig>>> {
    let Some(part) = part else { return Ok(None) };
    let source = Source::open(role, part, folder)?;
    if source.kind != Kind::Svae {
        let reason = format!("`{}` is no adapter, expected svae", source.kind);
        return Err(wm_model::Error::config("kind", reason).into());
    }
    let config: SvaeConfig = parse(&source.config)?;
    let tensors = source.survey(|loader| Svae::load(&config, loader))?;
    Ok(Some(Opened {
        source,
        config,
        tensors,
    }))
}

/// The transition that the description names or, with the latent space that it was trained on, the file beside it.
pub(super) fn transition_part(
    description: &Description,
    folder: &Path,
) -> Result<(Option<TransitionPart>, Option<LatentSpace>)> {
    let trained = folder.join(TRANSITION_FILE);
    if description.transition.is_some() || !trained.is_file() {
        return Ok((description.transition.clone(), None));
    }
    let (part, space) = TransitionPart::trained(&trained)?;
    Ok((Some(part), Some(space)))
}

pub(super) fn open_transition(part: &TransitionPart, folder: &Path) -> Result<Opened<Dynamics>> {
    let source = Source::open("transition", &part.part(), folder)?;
    let dit: DitConfig = parse(&source.config)?;
    let mut actions = part.actions.clone();
    actions
        .entry("action_dim")
        .or_insert_with(|| dit.action_dim.into());
    // The rule that the published checkpoints were trained with, not that of models of our own.
    actions
        .entry("accumulation")
        .or_insert_with(|| "index".into());
    let encoding: ActionEncoding = parse(&serde_json::Value::Object(actions).to_string())?;
    let wrong = |reason: String| wm_model::Error::config("actions", reason);
    if encoding.action_dim() != dit.action_dim {
        let reason = format!(
            "action_dim {}, expected {} of the configuration",
            encoding.action_dim(),
            dit.action_dim
        );
        return Err(wrong(reason).into());
    }
    let published = dit.transition()?;
    let config = TransitionConfig {
        frame_skip: encoding.frame_skip(),
        parametrisation: part.parametrisation,
        action_alignment: part.action_alignment,
        sampler: part.sampler.clone().unwrap_or(published.sampler.clone()),
        ..published
    };
    config.validate()?;
    let tensors = source.survey(|loader| build_transition(config.clone(), loader))?;
    Ok(Opened {
        source,
        config: Dynamics {
            dit,
            config,
            encoding,
        },
        tensors,
    })
}

pub(super) fn open_decoder(description: &Description, folder: &Path) -> Result<Option<Pictures>> {
    let Some(part) = &description.decoder else {
        return Ok(None);
    };
    let source = Source::open("decoder", &part.part(), folder)?;
    let config = DecoderConfig::parse(source.kind, &source.config)?;
    let tensors = source.survey(|loader| config.load(loader))?;
    Ok(Some(Pictures {
        decoder: Opened {
            source,
            config,
            tensors,
        },
        adapter: open_adapter(part.adapter.as_ref(), folder, "the decoder's adapter")?,
    }))
}

pub(super) fn statistics(
    description: &Description,
    folder: &Path,
    channels: usize,
) -> Result<Normalisation> {
    let normalisation = match &description.normalisation {
        None => return Ok(Normalisation::identity(channels)),
        Some(Statistics::Values { mean, std }) => Normalisation {
            mean: mean.clone(),
            std: std.clone(),
        },
        Some(Statistics::File(name)) => {
            let checkpoint = Checkpoint::open(folder.join(name))?;
            let values = |name| -> Result<Vec<f32>> {
                let tensor = checkpoint.tensor(name, candle_core::DType::F32)?;
                Ok(tensor.flatten_all()?.to_vec1()?)
            };
            Normalisation {
                mean: values(MEAN)?,
                std: values(STD)?,
            }
        }
    };
    normalisation.check(channels)?;
    Ok(normalisation)
}
