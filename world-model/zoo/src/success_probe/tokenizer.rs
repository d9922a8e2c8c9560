//! Instructions as tokens of SigLIP 2's text tower.

use std::path::Path;

use tokenizers::{
    PaddingDirection, PaddingParams, PaddingStrategy, PostProcessor as _, Tokenizer,
    TruncationParams,
};

use crate::vit::SiglipTextConfig;
use crate::{Error, Result};

/// Longest instruction \[byte\], far more than what 64 tokens hold: what an evaluator reads comes from others.
const MAX_BYTES: usize = 4096;

/// Name of Gemma's padding, where the file does not say how to pad.
const PAD: &str = "<pad>";

/// The tokenizer of a text tower: Hugging Face's tokenizer.json, used as SigLIP 2 was trained.
///
/// That is: lower-cased, cut off behind the tower's last position (the end-of-text token of the file's template stays)
/// and padded to it on the right, as Hugging Face's `Siglip2Tokenizer` does whatever the file says.
#[derive(Clone, Debug)]
pub struct InstructionTokenizer {
    tokenizer: Tokenizer,
}

impl InstructionTokenizer {
    /// Reads a tokenizer.json for the text tower of `config`.
    ///
    /// # Errors
    /// Names the file: if it cannot be read, is no tokenizer, has no padding, or has more tokens than the tower's
    /// vocabulary.
    pub(crate) fn open(path: &Path, config: &SiglipTextConfig) -> Result<Self> {
        let wrong = |reason: String| Error::ConfigFile {
            file: path.display().to_string(),
            reason,
        };
        let bytes = std::fs::read(path).map_err(|error| Error::io(path, error))?;
        let mut tokenizer = Tokenizer::from_bytes(bytes)
            .map_err(|error| wrong(format!("not a tokenizer.json: {error}")))?;
        let (tokens, known) = (tokenizer.get_vocab_size(true), config.vocab_size);
        if tokens > known {
            let reason = format!("{tokens} tokens, the text tower knows {known} (vocab_size)");
            return Err(wrong(reason));
        }
        let (pad_id, pad_token) = match tokenizer.get_padding() {
            Some(padding) => (padding.pad_id, padding.pad_token.clone()),
            None => match tokenizer.token_to_id(PAD) {
                Some(id) => (id, PAD.to_owned()),
                None => return Err(wrong(format!("no padding and no token {PAD}"))),
            },
        };
        let length = config.max_position_embeddings;
        let added = tokenizer
            .get_post_processor()
            .map_or(0, |template| template.added_tokens(false));
        if added >= length {
            let reason = format!(
                "adds {added} tokens to a text, the text tower has {length} positions in all"
            );
            return Err(wrong(reason));
        }
        tokenizer.with_padding(Some(PaddingParams {
            strategy: PaddingStrategy::Fixed(length),
            direction: PaddingDirection::Right,
            pad_id,
            pad_token,
            ..PaddingParams::default()
        }));
        tokenizer
            .with_truncation(Some(TruncationParams {
                max_length: length,
                ..TruncationParams::default()
            }))
            .map_err(|error| wrong(error.to_string()))?;
        Ok(Self { tokenizer })
    }

    /// Token ids of an instruction, as many as the tower has positions, and for each whether it is a token (1) or
    /// padding (0).
    ///
    /// # Errors
    /// If the instruction is longer than 4096 bytes, or has what the tokenizer knows no token for.
    pub fn encode(&self, instruction: &str) -> Result<(Vec<u32>, Vec<u32>)> {
        let wrong = |reason: String| Error::from(wm_model::Error::config("instruction", reason));
        if instruction.len() > MAX_BYTES {
            let bytes = instruction.len();
            return Err(wrong(format!(
                "{bytes} bytes, expected at most {MAX_BYTES}"
            )));
        }
        let encoding = self
            .tokenizer
            .encode(instruction.to_lowercase(), true)
            .map_err(|error| wrong(error.to_string()))?;
        let mask = encoding.get_attention_mask().to_vec();
        Ok((encoding.get_ids().to_vec(), mask))
    }
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use super::super::tests::TOKENIZER;
    use super::*;

    fn tower() -> SiglipTextConfig {
        SiglipTextConfig {
            vocab_size: 10,
            max_position_embeddings: 6,
            ..SiglipTextConfig::default()
        }
    }

    fn written(content: &str) -> (TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokenizer.json");
        std::fs::write(&path, content).unwrap();
        (folder, path)
    }

    #[test]
    fn instruction_is_lower_cased_ended_and_padded() {
        let (_folder, path) = written(TOKENIZER);
        let tokenizer = InstructionTokenizer::open(&path, &tower()).unwrap();
        let encode = |text: &str| tokenizer.encode(text).unwrap();
        let expected = (vec![3, 4, 5, 1, 0, 0], vec![1, 1, 1, 1, 0, 0]);
        assert_eq!(encode("Put the CUP"), expected);
        // The end stays where the rest is cut off.
        let (ids, mask) = encode("put the cup on the plate");
        assert_eq!((ids, mask), (vec![3, 4, 5, 7, 4, 1], vec![1; 6]));
        assert_eq!(encode("").0, [1, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn how_to_pad_is_the_towers_not_the_files() {
        let padding = r#""padding": {"strategy": "BatchLongest", "direction": "Left", "pad_to_multiple_of": 4,
            "pad_id": 9, "pad_type_id": 0, "pad_token": "drawer"}"#;
        let (_folder, path) = written(&TOKENIZER.replace(r#""padding": null"#, padding));
        let tokenizer = InstructionTokenizer::open(&path, &tower()).unwrap();
        let (ids, mask) = tokenizer.encode("open the drawer").unwrap();
        assert_eq!(ids, [8, 4, 9, 1, 9, 9]);
        assert_eq!(mask, [1, 1, 1, 1, 0, 0], "a word is no padding by its id");
    }

    #[test]
    fn what_is_no_tokenizer_of_the_tower_is_named() {
        let opened = |content: &str, config: &SiglipTextConfig| {
            let (_folder, path) = written(content);
            let message = InstructionTokenizer::open(&path, config).unwrap_err();
            let message = message.to_string();
            assert!(
                message.starts_with(&path.display().to_string()),
                "{message}"
            );
            message
        };
        assert!(opened("{}", &tower()).contains("not a tokenizer.json"));
        let small = SiglipTextConfig {
            vocab_size: 9,
            ..tower()
        };
        assert!(opened(TOKENIZER, &small).contains("10 tokens, the text tower knows 9"));
        let short = SiglipTextConfig {
            max_position_embeddings: 1,
            ..tower()
        };
        assert!(opened(TOKENIZER, &short).contains("adds 1 tokens to a text"));
        let unpadded = TOKENIZER.replace("<pad>", "<nothing>");
        assert!(opened(&unpadded, &tower()).contains("no padding and no token <pad>"));
    }

    #[test]
    fn an_endless_instruction_is_refused() {
        let (_folder, path) = written(TOKENIZER);
        let tokenizer = InstructionTokenizer::open(&path, &tower()).unwrap();
        let message = tokenizer.encode(&"cup ".repeat(1025)).unwrap_err();
        assert!(message.to_string().contains("4100 bytes"), "{message}");
    }
}
