//! The success probe of a model folder: opened with the rest, loaded by whom it is for.

use std::path::{Path, PathBuf};

use candle_core::DType;
use wm_model::autoencoder::Normalisation;

use super::source::Source;
use super::{Description, Opened, ProbePart, TextPart, giver};
use crate::kinds::parse;
use crate::success_probe::{
    InstructionTokenizer, SuccessClassifier, SuccessProbe, SuccessProbeConfig,
};
use crate::vit::{SiglipText, SiglipTextConfig};
use crate::{Error, Result};

/// The probe, and what reads the instruction for it.
#[derive(Clone, Debug)]
pub(super) struct Probe {
    pub(super) probe: Opened<SuccessProbeConfig>,
    pub(super) text: TextTower,
}

/// The text tower, and where its tokenizer is.
#[derive(Clone, Debug)]
pub(super) struct TextTower {
    pub(super) tower: Opened<SiglipTextConfig>,
    /// Read where the probe is loaded only: Gemma's is some 30 MB of JSON.
    tokenizer: PathBuf,
}

pub(super) fn open(part: &ProbePart, folder: &Path) -> Result<Opened<SuccessProbeConfig>> {
    let source = Source::open("probe", &part.part(), folder)?;
    let config: SuccessProbeConfig = parse(&source.config)?;
    let tensors = source.survey(|loader| SuccessProbe::load(&config, loader))?;
    Ok(Opened {
        source,
        config,
        tensors,
    })
}

impl TextTower {
    pub(super) fn open(part: &TextPart, folder: &Path) -> Result<Self> {
        let source = Source::open("the probe's text tower", &part.part(), folder)?;
        let config: SiglipTextConfig = parse(&source.config)?;
        let tensors = source.survey(|loader| SiglipText::load(&config, loader))?;
        let tokenizer = folder.join(&part.tokenizer);
        std::fs::metadata(&tokenizer).map_err(|error| Error::io(&tokenizer, error))?;
        let tower = Opened {
            source,
            config,
            tensors,
        };
        Ok(Self { tower, tokenizer })
    }
}

impl Probe {
    /// Whether the probe reads these latents, and the features of the text tower.
    pub(super) fn check(
        &self,
        description: &Description,
        [_, _, channels]: [usize; 3],
    ) -> Result<(), String> {
        let config = &self.probe.config;
        if config.features != channels {
            return Err(format!(
                "probe: features is {}, but {} gives latents of {channels} channels",
                config.features,
                giver(description, 1)
            ));
        }
        let width = self.text.tower.config.hidden_size;
        if config.text_features != width {
            return Err(format!(
                "probe: text_features is {}, but its text tower gives {width} (hidden_size)",
                config.text_features
            ));
        }
        Ok(())
    }

    pub(super) fn load(
        &self,
        dtype: DType,
        normalisation: Normalisation,
    ) -> Result<SuccessClassifier> {
        let Self { probe, text } = self;
        let tower = &text.tower;
        // First what is cheap: it may be wrong.
        let tokenizer = InstructionTokenizer::open(&text.tokenizer, &tower.config)?;
        Ok(SuccessClassifier {
            tokenizer,
            text: tower
                .source
                .load(dtype, |loader| SiglipText::load(&tower.config, loader))?,
            probe: probe
                .source
                .load(dtype, |loader| SuccessProbe::load(&probe.config, loader))?,
            normalisation,
        })
    }
}

#[cfg(test)]
mod tests;
