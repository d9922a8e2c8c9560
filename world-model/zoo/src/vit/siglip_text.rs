//! SigLIP 2, text tower: what the success probe reads instructions with.
//!
//! Checkpoint <https://huggingface.co/google/siglip2-so400m-patch14-224>, a Hugging Face
//! `SiglipTextModel`: 27 x 1152, Gemma's vocabulary of 256000, 64 positions (`docs/architecture.md#encoders`). It was trained with texts padded to 64 tokens and no mask, so that padding is
//! attended to: that is what [`SiglipText::forward`] does unless it is given a mask.
//!
//! Tokens come from the caller; there is no tokenizer here. The configuration is Hugging Face's
//! config.json as it is, that of the text tower or that of both with the former under
//! `text_config`. Names are Hugging Face's (`text_model.*`).

use candle_core::{DType, Tensor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Block;
use super::siglip::{LayerSizes, layers, nested, tower};
use crate::Result;
use crate::layers::{Activation, LayerNorm, Linear};
use crate::loader::Loader;
use crate::sizes::{check_counts, check_multiple, check_sizes, shape_error};

/// Sizes of the text tower, with the names and the defaults of Hugging Face's `SiglipTextConfig`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self", default)]
pub(crate) struct SiglipTextConfig {
    /// Number of different tokens.
    pub(crate) vocab_size: usize,
    /// Width of the tokens.
    pub(crate) hidden_size: usize,
    /// Hidden width of the feed-forward networks.
    pub(crate) intermediate_size: usize,
    /// Number of blocks.
    pub(crate) num_hidden_layers: usize,
    /// Attention heads.
    pub(crate) num_attention_heads: usize,
    /// Length of the longest text in tokens.
    pub(crate) max_position_embeddings: usize,
    /// Activation of the feed-forward networks.
    pub(crate) hidden_act: Activation,
    /// Epsilon of every LayerNorm.
    pub(crate) layer_norm_eps: f64,
    /// Width of the pooled feature; that of the tokens if it is not given.
    pub(crate) projection_size: Option<usize>,
}

impl Default for SiglipTextConfig {
    fn default() -> Self {
        Self {
            vocab_size: 32_000,
            hidden_size: 768,
            intermediate_size: 3072,
            num_hidden_layers: 12,
            num_attention_heads: 12,
            max_position_embeddings: 64,
            hidden_act: Activation::GeluTanh,
            layer_norm_eps: 1e-6,
            projection_size: None,
        }
    }
}

impl<'de> Deserialize<'de> for SiglipTextConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let value = nested(deserializer, "text_config")?;
        Self::deserialize(value).map_err(serde::de::Error::custom)
    }
}

impl Serialize for SiglipTextConfig {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

impl SiglipTextConfig {
    /// `google/siglip2-so400m-patch14-224`.
    pub(crate) fn so400m() -> Self {
        Self {
            vocab_size: 256_000,
            hidden_size: 1152,
            intermediate_size: 4304,
            num_hidden_layers: 27,
            num_attention_heads: 16,
            projection_size: Some(1152),
            ..Self::default()
        }
    }

    fn validate(&self) -> Result<()> {
        check_sizes(&[
            ("vocab_size", self.vocab_size),
            ("hidden_size", self.hidden_size),
            ("intermediate_size", self.intermediate_size),
            ("num_attention_heads", self.num_attention_heads),
            ("max_position_embeddings", self.max_position_embeddings),
            ("projection_size", self.projection_size.unwrap_or(1)),
        ])?;
        check_counts(&[("num_hidden_layers", self.num_hidden_layers)])?;
        check_multiple(
            ("hidden_size", self.hidden_size),
            ("num_attention_heads", self.num_attention_heads),
        )
    }
}

/// The text tower.
#[derive(Clone, Debug)]
pub struct SiglipText {
    config: SiglipTextConfig,
    /// (vocabulary, hidden).
    tokens: Tensor,
    /// (positions, hidden).
    positions: Tensor,
    blocks: Vec<Block>,
    norm: LayerNorm,
    head: Linear,
}

impl SiglipText {
    /// Loads the text tower; a vision tower and a logit scale beside it are ignored.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub(crate) fn load(config: &SiglipTextConfig, loader: &Loader<'_>) -> Result<Self> {
        config.validate()?;
        for prefix in ["vision_model.", "logit_scale", "logit_bias"] {
            loader.ignore(prefix);
        }
        let loader = tower(loader, "text_model", "embeddings.token_embedding.weight");
        // Old files hold the numbers 0, 1, 2, ...
        loader.ignore("embeddings.position_ids");
        let width = config.hidden_size;
        let tokens = "embeddings.token_embedding.weight";
        let positions = "embeddings.position_embedding.weight";
        let sizes = LayerSizes {
            width,
            mlp: config.intermediate_size,
            heads: config.num_attention_heads,
            activation: config.hidden_act,
            eps: config.layer_norm_eps,
        };
        Ok(Self {
            config: config.clone(),
            tokens: loader.tensor(tokens, &[config.vocab_size, width])?,
            positions: loader.tensor(positions, &[config.max_position_embeddings, width])?,
            blocks: layers(&sizes, config.num_hidden_layers, &loader)?,
            norm: loader.layer_norm("final_layer_norm", width, config.layer_norm_eps)?,
            head: loader.linear("head", width, config.projection_size.unwrap_or(width))?,
        })
    }

    /// Features of the tokens behind the final LayerNorm: `ids` (B, L), integers below the
    /// vocabulary's size, to (B, L, hidden), f32.
    ///
    /// `mask` (B, L), 1 for tokens and 0 for padding, hides the padding; the published checkpoints
    /// were trained without it.
    ///
    /// # Errors
    /// If the text is too long, a token is not in the vocabulary, or the shapes differ.
    pub(crate) fn forward(&self, ids: &Tensor, mask: Option<&Tensor>) -> Result<Tensor> {
        let (b, l) = match ids.dims() {
            &[b, l] if l > 0 && l <= self.config.max_position_embeddings => (b, l),
            _ => {
                let longest = self.config.max_position_embeddings;
                let expected = format!("(B, L) with L from 1 to {longest}");
                return Err(shape_error("the tokens", expected, ids));
            }
        };
        let ids = ids.to_device(self.tokens.device())?.flatten_all()?;
        self.check_vocabulary(&ids)?;
        let embedded = self
            .tokens
            .contiguous()?
            .index_select(&ids.contiguous()?, 0)?;
        let mut x = embedded
            .reshape((b, l, self.config.hidden_size))?
            .broadcast_add(&self.positions.narrow(0, 0, l)?)?;
        let mask = mask
            .map(|mask| additive_mask(mask, (b, l), &x))
            .transpose()?;
        for block in &self.blocks {
            x = block.forward(&x, mask.as_ref(), None)?;
        }
        Ok(self.norm.forward(&x)?.to_dtype(DType::F32)?)
    }

    /// Checks that every token of `ids` (n) is in the vocabulary.
    fn check_vocabulary(&self, ids: &Tensor) -> Result<()> {
        let ids = ids.to_dtype(DType::I64)?.to_vec1::<i64>()?;
        let known = |id: &i64| usize::try_from(*id).is_ok_and(|id| id < self.config.vocab_size);
        match ids.iter().find(|id| !known(id)) {
            None => Ok(()),
            Some(id) => {
                let reason = format!("token {id}, expected 0 to {}", self.config.vocab_size - 1);
                Err(wm_model::Error::config("input_ids", reason).into())
            }
        }
    }

    /// The pooled feature of texts: `features` (B, L, hidden) of [`SiglipText::forward`], padded to
    /// the full length, of which the last token goes through the head: (B, projection size), f32.
    ///
    /// # Errors
    /// If the shape differs.
    pub fn pool(&self, features: &Tensor) -> Result<Tensor> {
        let (_, l, _) = features.dims3()?;
        let last = features.narrow(1, l.saturating_sub(1), 1)?.squeeze(1)?;
        let last = last.to_dtype(self.tokens.dtype())?.contiguous()?;
        Ok(self.head.forward(&last)?.to_dtype(DType::F32)?)
    }
}

/// What to add to scores so that the padding of `mask` (B, L) is not seen: (B, 1, 1, L), in the
/// number format of `like`.
pub(crate) fn additive_mask(
    mask: &Tensor,
    (b, l): (usize, usize),
    like: &Tensor,
) -> Result<Tensor> {
    if mask.dims() != [b, l] {
        return Err(shape_error("the mask", format!("({b}, {l})"), mask));
    }
    let seen = mask.to_device(like.device())?.ne(0.0)?;
    // Far below every score, yet finite in every format: a text of nothing but padding is then
    // averaged and does not become NaN.
    let hidden = seen.to_dtype(DType::F32)?.affine(1e30, -1e30)?;
    let hidden = hidden.to_dtype(like.dtype())?;
    Ok(hidden
        .unsqueeze(1)?
        .unsqueeze(1)?
        .broadcast_as((b, 1, 1, l))?
        .contiguous()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;
    use wm_model::Kernels;

    fn small() -> SiglipTextConfig {
        SiglipTextConfig {
            vocab_size: 20,
            hidden_size: 32,
            intermediate_size: 50,
            num_hidden_layers: 2,
            num_attention_heads: 4,
            max_position_embeddings: 8,
            projection_size: Some(5),
            ..SiglipTextConfig::default()
        }
    }

    #[test]
    fn so400m_has_the_published_size() {
        // With the vision tower, logit scale and logit bias: 1 135 463 602, the 1.1 B of the card.
        let loader = Loader::skeleton(Kernels::Candle);
        SiglipText::load(&SiglipTextConfig::so400m(), &loader).unwrap();
        assert_eq!(loader.parameters(), 707_782_896);
    }

    #[test]
    fn a_small_one_has_the_shape_of_its_configuration() {
        let model = SiglipText::load(&small(), &Loader::skeleton(Kernels::Candle)).unwrap();
        let ids = Tensor::new(&[[1_u32, 19, 0], [3, 4, 5]], &Device::Cpu).unwrap();
        let mask = Tensor::new(&[[1_u32, 1, 0], [1, 1, 1]], &Device::Cpu).unwrap();
        for mask in [None, Some(&mask)] {
            let features = model.forward(&ids, mask).unwrap();
            assert_eq!(features.dims(), [2, 3, 32]);
            assert_eq!(model.pool(&features).unwrap().dims(), [2, 5]);
        }
    }

    #[test]
    fn a_text_too_long_is_refused() {
        let model = SiglipText::load(&small(), &Loader::skeleton(Kernels::Candle)).unwrap();
        let ids = Tensor::zeros((1, 9), DType::U32, &Device::Cpu).unwrap();
        let message = model.forward(&ids, None).unwrap_err().to_string();
        assert!(message.contains("from 1 to 8"), "{message}");
    }

    #[test]
    fn a_token_beyond_the_vocabulary_is_named() {
        let model = SiglipText::load(&small(), &Loader::skeleton(Kernels::Candle)).unwrap();
        for id in [20_i64, -1] {
            let ids = Tensor::new(&[[1, id]], &Device::Cpu).unwrap();
            let message = model.forward(&ids, None).unwrap_err().to_string();
            assert!(message.contains(&format!("token {id}")), "{message}");
        }
    }

    #[test]
    fn a_configuration_of_hugging_face_is_taken_as_it_is() {
        let json = r#"{"model_type": "siglip", "vision_config": {"hidden_size": 7},
            "text_config": {"hidden_size": 1152, "intermediate_size": 4304,
            "model_type": "siglip_text_model", "num_attention_heads": 16,
            "num_hidden_layers": 27, "projection_size": 1152, "vocab_size": 256000}}"#;
        let config: SiglipTextConfig = serde_json::from_str(json).unwrap();
        assert_eq!(config, SiglipTextConfig::so400m());
    }

    #[test]
    fn padding_is_hidden_from_scores() {
        let like = Tensor::zeros((2, 2), DType::F32, &Device::Cpu).unwrap();
        let mask = Tensor::new(&[[1_i64, 0], [1, 1]], &Device::Cpu).unwrap();
        let added = additive_mask(&mask, (2, 2), &like).unwrap();
        assert_eq!(added.dims(), [2, 1, 1, 2]);
        let values = added.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(values, [0.0, -1e30, 0.0, 0.0]);
    }
}
