use wm_model::{LatentSpace, Weights, autoencoder::Normalisation, transition::LATENT_SPACE_KEY};

use super::{
    Instructed, Judge, Reader, SuccessClassifier, SuccessProbe, SuccessProbeConfig, WordEmbedding,
    WordsConfig,
};
use crate::{Engine, Loader, Result, loader::OfWeights};

/// Metadata key of the [`SuccessProbeConfig`] (JSON).
pub const PROBE_KEY: &str = "success_probe";
/// Metadata key of the [`WordsConfig`] (JSON).
pub const WORDS_KEY: &str = "words";

impl SuccessClassifier {
    /// The probe of a file that `wm train probe` wrote, for latents of `space`. It reads them normalised, as they are
    /// published.
    ///
    /// # Errors
    /// If it was trained on another space, or a tensor or an entry of the metadata is missing, misshapen or unexpected.
    pub fn of_trained(weights: Weights, space: &LatentSpace) -> Result<Self> {
        let trained_on: LatentSpace = weights.json(LATENT_SPACE_KEY)?;
        trained_on.require(space)?;
        let config: SuccessProbeConfig = weights.json(PROBE_KEY)?;
        let words: WordsConfig = weights.json(WORDS_KEY)?;
        let supply = OfWeights(&weights);
        let loader = Loader::supplied(&supply, Engine::Cpu);
        let probe = SuccessProbe::load(&config, &loader)?;
        let words = WordEmbedding::load(&words, &loader)?;
        weights.finish()?;
        Ok(Self::of_words(words, probe, space.channels))
    }

    /// A probe of normalised latents, with the words that it knows.
    pub fn of_words(words: WordEmbedding, probe: SuccessProbe, channels: usize) -> Self {
        Self {
            judge: Judge::Instructed(Box::new(Instructed {
                reader: Reader::Words(words),
                probe,
            })),
            normalisation: Normalisation::identity(channels),
        }
    }
}
