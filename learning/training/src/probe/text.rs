//! Readers of instructions for a probe in training.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result};
use wm_model::weights::WeightsBuilder;
use wm_zoo::{
    Loader,
    success_probe::{Reader, Reading, TEXT_TOWER_KEY, WORDS_KEY, WordEmbedding, WordsConfig},
};

/// A reader of instructions.
pub(super) enum Text {
    /// A vocabulary with learned features.
    Words(WordEmbedding),
    /// A frozen text tower, with each instruction read once.
    Tower(Tower),
    /// No reader, for a probe without instructions.
    None,
}

/// Instructions read by a frozen text tower.
pub(super) struct Tower {
    folder: PathBuf,
    readings: BTreeMap<String, Reading>,
    /// Channels of a token's feature.
    features: usize,
}

impl Tower {
    /// Reads all instructions with the text tower of `folder`.
    pub(super) fn read<'a>(
        folder: &Path,
        instructions: impl Iterator<Item = &'a str>,
    ) -> Result<Self> {
        let folder = std::path::absolute(folder).with_context(|| folder.display().to_string())?;
        let context = || format!("the text tower {}", folder.display());
        let reader = Reader::siglip(&folder).with_context(context)?;
        let mut readings = BTreeMap::new();
        let mut features = 0;
        for instruction in instructions {
            if readings.contains_key(instruction) {
                continue;
            }
            let reading = reader.read(instruction).with_context(context)?;
            features = reading.features.dim(2)?;
            readings.insert(instruction.to_owned(), reading);
        }
        Ok(Self {
            folder,
            readings,
            features,
        })
    }

    /// Channels of a token's feature.
    pub(super) fn features(&self) -> usize {
        self.features
    }
}

impl Text {
    pub(super) fn words(config: &WordsConfig, loader: &Loader<'_>) -> Result<Self> {
        Ok(Self::Words(WordEmbedding::load(config, loader)?))
    }

    /// Features of an instruction; `None` without a reader.
    pub(super) fn read(&self, instruction: &str) -> Result<Option<Reading>> {
        match self {
            Self::Words(words) => Ok(Some(Reading {
                features: words.read(instruction)?,
                mask: None,
            })),
            Self::Tower(tower) => {
                let reading = tower.readings.get(instruction).cloned();
                let reading = reading.with_context(|| format!("`{instruction}` was not read"))?;
                Ok(Some(reading))
            }
            Self::None => Ok(None),
        }
    }

    /// Adds the reader to a weights file.
    pub(super) fn describe(&self, weights: &mut WeightsBuilder) -> Result<()> {
        let (key, value) = match self {
            Self::Words(words) => (WORDS_KEY, serde_json::to_string(words.config())?),
            Self::Tower(tower) => (TEXT_TOWER_KEY, serde_json::to_string(&tower.folder)?),
            Self::None => return Ok(()),
        };
        weights.metadata(key, value);
        Ok(())
    }

    /// Description for messages.
    pub(super) fn summary(&self) -> String {
        match self {
            Self::Words(words) => format!("{} words", words.config().vocabulary.len()),
            Self::Tower(tower) => format!("{} instructions", tower.readings.len()),
            Self::None => "whatever the instruction".to_owned(),
        }
    }
}
