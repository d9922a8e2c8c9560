use std::path::{Path, PathBuf};

use wm_model::{
    Compute, Kernels, LatentSpace, Weights, autoencoder::Normalisation,
    transition::LATENT_SPACE_KEY,
};

use super::{
    Instructed, InstructionTokenizer, Judge, ProbeNetwork, ProbeNetworkConfig, Reader,
    SuccessClassifier, WordEmbedding, WordsConfig,
};
use crate::kinds::kind::Kind;
use crate::pooled_probe::PooledProbe;
use crate::vit::{SiglipText, SiglipTextConfig};
use crate::{Checkpoint, Error, Loader, Result, checkpoint::Average, loader::OfWeights};

/// Metadata key of the [`ProbeNetworkConfig`] (JSON).
pub const PROBE_KEY: &str = "success_probe";
/// Metadata key of the [`WordsConfig`] (JSON), for a probe that reads words.
pub const WORDS_KEY: &str = "words";
/// Metadata key of the folder of a text tower (a JSON string), for a probe that reads its features.
pub const TEXT_TOWER_KEY: &str = "text_tower";

impl SuccessClassifier {
    /// The probe of a file that `wm train probe` wrote, for latents of `space`. It reads them normalised, as they are
    /// published.
    ///
    /// # Errors
    /// If it was trained on another space, a tensor or an entry of the metadata is missing, misshapen or unexpected, or its
    /// text tower cannot be opened.
    pub fn of_trained(weights: Weights, space: &LatentSpace) -> Result<Self> {
        let trained_on: LatentSpace = weights.json(LATENT_SPACE_KEY)?;
        trained_on.require(space)?;
        let config: ProbeNetworkConfig = weights.json(PROBE_KEY)?;
        let supply = OfWeights(&weights);
        let probe = ProbeNetwork::load(&config, &Loader::supplied(&supply, Kernels::Cpu))?;
        let judge = match probe {
            ProbeNetwork::Linear(probe) => Judge::Pooled(PooledProbe::Linear(probe)),
            ProbeNetwork::Temporal(probe) => Judge::Pooled(PooledProbe::Temporal(probe)),
            probe @ (ProbeNetwork::Transformer(_) | ProbeNetwork::Grounded(_)) => {
                let reader = Reader::of_trained(&weights)?;
                Judge::Instructed(Box::new(Instructed { reader, probe }))
            }
        };
        weights.finish()?;
        Ok(Self {
            judge,
            normalisation: Normalisation::identity(space.channels),
        })
    }
}

impl Reader {
    /// What reads instructions for the probe of a file that `wm train probe` wrote.
    ///
    /// # Errors
    /// If its words are missing or misshapen, or its text tower cannot be opened.
    pub fn of_trained(weights: &Weights) -> Result<Self> {
        if weights.metadata(TEXT_TOWER_KEY).is_some() {
            let folder: PathBuf = weights.json(TEXT_TOWER_KEY)?;
            return Self::siglip(&folder);
        }
        let words: WordsConfig = weights.json(WORDS_KEY)?;
        let supply = OfWeights(weights);
        let loader = Loader::supplied(&supply, Kernels::Cpu);
        Ok(Self::Words(WordEmbedding::load(&words, &loader)?))
    }

    /// SigLIP 2's text tower in a folder as Hugging Face publishes it: `config.json`, `model.safetensors` and
    /// `tokenizer.json`.
    ///
    /// # Errors
    /// If a file cannot be read or is not of a text tower.
    pub fn siglip(folder: &Path) -> Result<Self> {
        let path = folder.join("config.json");
        let config = std::fs::read_to_string(&path).map_err(|error| Error::io(&path, error))?;
        let config: SiglipTextConfig = crate::kinds::parse::parse(&config)?;
        // First what is cheap: it may be wrong.
        let tokenizer = InstructionTokenizer::open(&folder.join("tokenizer.json"), &config)?;
        let checkpoint = Checkpoint::open(folder.join("model.safetensors"))?;
        let checkpoint = Kind::Siglip2Text.weights(&checkpoint, Average::Ema);
        let loader = Loader::new(&checkpoint, &Compute::default())?;
        let text = SiglipText::load(&config, &loader)?;
        loader.finish()?;
        Ok(Self::Siglip {
            tokenizer: Box::new(tokenizer),
            text: Box::new(text),
        })
    }
}
