//! Instructions of a closed vocabulary, for a success probe that needs no text tower.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use crate::loader::Loader;
use crate::sizes::check_sizes;
use crate::{Error, Result};

/// Words that a vocabulary has at most.
const MOST_WORDS: usize = 1 << 16;

/// Name of the tensor of features of words.
pub const WORD_FEATURES: &str = "word_embed";
/// Name of the tensor of features of the words' places in an instruction.
pub const PLACE_FEATURES: &str = "place_embed";

/// A vocabulary and its features.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WordsConfig {
    /// Every word that is known, in lower case.
    pub vocabulary: Vec<String>,
    /// Words of the longest instruction.
    pub max_words: usize,
    /// Channels of a word's feature.
    pub features: usize,
}

impl WordsConfig {
    /// The vocabulary of these instructions, in alphabetical order.
    pub fn of<'a>(instructions: impl IntoIterator<Item = &'a str>, features: usize) -> Self {
        let empty = Self {
            vocabulary: Vec::new(),
            max_words: 1,
            features,
        };
        empty.with(instructions)
    }

    /// The same words in the same places, followed by the new words of these instructions in alphabetical order.
    #[must_use]
    pub fn with<'a>(mut self, instructions: impl IntoIterator<Item = &'a str>) -> Self {
        let mut new = std::collections::BTreeSet::new();
        for instruction in instructions {
            let words = words(instruction);
            self.max_words = self.max_words.max(words.len());
            new.extend(words);
        }
        new.retain(|word| !self.vocabulary.contains(word));
        self.vocabulary.extend(new);
        self
    }

    /// The places of the words of `instruction` in the vocabulary.
    ///
    /// # Errors
    /// Names the word that is not in it; or if there are none, or too many.
    pub fn encode(&self, instruction: &str) -> Result<Vec<u32>> {
        let refused = |reason: String| Error::from(wm_model::Error::config("instruction", reason));
        let words = words(instruction);
        if words.is_empty() || words.len() > self.max_words {
            return Err(refused(format!(
                "{} words, expected 1 to {}",
                words.len(),
                self.max_words
            )));
        }
        let place = |word: &String| {
            let place = self.vocabulary.iter().position(|known| known == word);
            place.map(|place| place as u32).ok_or_else(|| {
                let known = self.vocabulary.join(", ");
                refused(format!("the probe does not know `{word}`, only: {known}"))
            })
        };
        words.iter().map(place).collect()
    }
}

/// The words of an instruction, in lower case and without punctuation.
#[must_use]
pub fn words(instruction: &str) -> Vec<String> {
    let words = instruction.split(|c: char| !c.is_alphanumeric());
    let words = words.filter(|word| !word.is_empty());
    words.map(str::to_lowercase).collect()
}

/// A learned feature for each word, to which one for its place in the instruction is added.
#[derive(Clone, Debug)]
pub struct WordEmbedding {
    config: WordsConfig,
    /// (words, features).
    words: Tensor,
    /// (max_words, features).
    places: Tensor,
}

impl WordEmbedding {
    /// Loads `word_embed` (words, features) and `place_embed` (max_words, features).
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &WordsConfig, loader: &Loader<'_>) -> Result<Self> {
        let (words, places) = (config.vocabulary.len(), config.max_words);
        check_sizes(&[
            ("vocabulary", words),
            ("max_words", places),
            ("features", config.features),
        ])?;
        if words > MOST_WORDS {
            let reason = format!("{words} words, expected at most {MOST_WORDS}");
            return Err(wm_model::Error::config("vocabulary", reason).into());
        }
        Ok(Self {
            words: loader.tensor(WORD_FEATURES, &[words, config.features])?,
            places: loader.tensor(PLACE_FEATURES, &[places, config.features])?,
            config: config.clone(),
        })
    }

    /// The vocabulary.
    pub fn config(&self) -> &WordsConfig {
        &self.config
    }

    /// The features (1, words, features) of an instruction.
    ///
    /// # Errors
    /// As [`WordsConfig::encode`].
    pub fn read(&self, instruction: &str) -> Result<Tensor> {
        let ids = self.config.encode(instruction)?;
        let count = ids.len();
        let ids = Tensor::from_vec(ids, count, self.words.device())?;
        let features = self.words.contiguous()?.index_select(&ids, 0)?;
        Ok((features + self.places.narrow(0, 0, count)?)?.unsqueeze(0)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_model::Kernels;

    #[test]
    fn a_vocabulary_is_that_of_its_instructions() {
        let config = WordsConfig::of(["Put the red cube in the bowl.", "pick the cup"], 4);
        assert_eq!(
            config.vocabulary,
            ["bowl", "cube", "cup", "in", "pick", "put", "red", "the"]
        );
        assert_eq!(config.max_words, 7);
        assert_eq!(config.encode("Pick  the RED cup!").unwrap(), [4, 7, 6, 2]);
        let error = config.encode("pick the banana").unwrap_err().to_string();
        assert!(
            error.contains("`banana`") && error.contains("bowl"),
            "{error}"
        );
        assert!(config.encode(" .").is_err());
        assert!(config.encode(&"the ".repeat(8)).is_err());

        let more = config.clone().with(["pick a banana", "the cup"]);
        assert_eq!(more.vocabulary[..8], config.vocabulary);
        assert_eq!(more.vocabulary[8..], ["a", "banana"]);
        assert_eq!(more.max_words, 7);
    }

    #[test]
    fn each_word_has_a_feature() {
        let config = WordsConfig::of(["pick the cup"], 4);
        let words = WordEmbedding::load(&config, &Loader::skeleton(Kernels::Candle)).unwrap();
        assert_eq!(words.read("the cup").unwrap().dims(), [1, 2, 4]);
    }
}
