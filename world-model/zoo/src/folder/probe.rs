//! The success probe of a model folder: opened with the rest, loaded only by the node that uses it.

use std::path::{Path, PathBuf};

use wm_model::Compute;
use wm_model::autoencoder::Normalisation;

use super::fit::giver;
use super::source::{KnownInputs, Source};
use super::{Description, Opened, ProbePart, TextPart};
use crate::kinds::{Kind, parse};
use crate::pooled_probe::config::PooledProbeConfig;
use crate::success_probe::{
    Instructed, InstructionTokenizer, Judge, ProbeNetwork, Reader, SuccessClassifier, SuccessProbe,
    SuccessProbeConfig,
};
use crate::vit::{SiglipText, SiglipTextConfig};
use crate::{Error, Result};

/// The probe, and what reads the instruction for one that takes it.
#[derive(Clone, Debug)]
pub(super) enum Probe {
    Instructed {
        probe: Box<Opened<SuccessProbeConfig>>,
        text: Box<TextTower>,
    },
    Pooled(Opened<PooledProbeConfig>),
}

/// The text tower, and where its tokenizer is.
#[derive(Clone, Debug)]
pub(super) struct TextTower {
    pub(super) tower: Opened<SiglipTextConfig>,
    /// Read where the probe is loaded only: Gemma's is some 30 MB of JSON.
    tokenizer: PathBuf,
}

fn open_instructed(source: Source) -> Result<Opened<SuccessProbeConfig>> {
    let config: SuccessProbeConfig = parse(&source.config)?;
    let tensors = source.survey(|loader| SuccessProbe::load(&config, loader))?;
    Ok(Opened {
        source,
        config,
        tensors,
    })
}

fn open_pooled(source: Source) -> Result<Opened<PooledProbeConfig>> {
    let config = PooledProbeConfig::parse(source.kind, &source.config)?;
    let tensors = source.survey(|loader| config.load(loader))?;
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
    /// Opens the probe of `part`; `in_part` says of which part an error is.
    pub(super) fn open(
        part: &ProbePart,
        folder: &Path,
        in_part: impl Fn(&'static str, Error) -> Error,
    ) -> Result<Self> {
        let in_probe = |error| in_part("probe", error);
        let wrong = |reason: String| in_probe(wm_model::Error::config("text", reason).into());
        let kind: Kind = part.kind.parse().map_err(in_probe)?;
        let open = || Source::open("probe", &part.part(), folder);
        match (kind, &part.text) {
            (Kind::SuccessProbe, Some(text)) => Ok(Self::Instructed {
                text: Box::new(
                    TextTower::open(text, folder).map_err(|error| in_part("probe.text", error))?,
                ),
                probe: Box::new(open().and_then(open_instructed).map_err(in_probe)?),
            }),
            (Kind::SuccessProbe, None) => Err(wrong(format!(
                "missing, a {kind} reads the instruction by a text tower"
            ))),
            (_, Some(_)) => Err(wrong(format!(
                "a {kind} reads no instruction, leave it out"
            ))),
            (_, None) => Ok(Self::Pooled(
                open().and_then(open_pooled).map_err(in_probe)?,
            )),
        }
    }

    /// Whether the probe reads these latents, and the features of the text tower.
    pub(super) fn check(
        &self,
        description: &Description,
        [_, _, channels]: [usize; 3],
    ) -> Result<(), String> {
        let features = match self {
            Self::Instructed { probe, .. } => probe.config.features,
            Self::Pooled(probe) => probe.config.features(),
        };
        if features != channels {
            return Err(format!(
                "probe: features is {features}, but {} gives latents of {channels} channels",
                giver(description, 1)
            ));
        }
        let Self::Instructed { probe, text } = self else {
            return Ok(());
        };
        let width = text.tower.config.hidden_size;
        if probe.config.text_features != width {
            return Err(format!(
                "probe: text_features is {}, but its text tower gives {width} (hidden_size)",
                probe.config.text_features
            ));
        }
        Ok(())
    }

    /// The checkpoints of the probe, and of what reads instructions for it.
    pub(super) fn sources(&self) -> Vec<&Source> {
        match self {
            Self::Instructed { probe, text } => vec![&probe.source, &text.tower.source],
            Self::Pooled(probe) => vec![&probe.source],
        }
    }

    pub(super) fn load(
        &self,
        compute: &Compute,
        known: &KnownInputs,
        normalisation: Normalisation,
    ) -> Result<SuccessClassifier> {
        let judge = match self {
            Self::Pooled(probe) => Judge::Pooled(
                probe
                    .source
                    .load(compute, known, |loader| probe.config.load(loader))?,
            ),
            Self::Instructed { probe, text } => {
                let tower = &text.tower;
                // First what is cheap: it may be wrong.
                let tokenizer = InstructionTokenizer::open(&text.tokenizer, &tower.config)?;
                let text = tower.source.load(compute, known, |loader| {
                    SiglipText::load(&tower.config, loader)
                })?;
                Judge::Instructed(Box::new(Instructed {
                    reader: Reader::Siglip {
                        tokenizer: Box::new(tokenizer),
                        text: Box::new(text),
                    },
                    probe: ProbeNetwork::Transformer(Box::new(probe.source.load(
                        compute,
                        known,
                        |loader| SuccessProbe::load(&probe.config, loader),
                    )?)),
                }))
            }
        };
        Ok(SuccessClassifier {
            judge,
            normalisation,
        })
    }
}

#[cfg(test)]
mod tests;
