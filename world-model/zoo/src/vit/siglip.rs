//! SigLIP 2, vision tower; any checkpoint of fixed resolution of the SigLIP family.
//!
//! Paper: "SigLIP 2" (arXiv 2502.14786); checkpoint
//! <https://huggingface.co/google/siglip2-so400m-patch14-224>, a Hugging Face `SiglipVisionModel`:
//! 27 x 1152 at 224x224, 427.681 M parameters with the pooling head. The feature is the output of
//! the last layer **before** `post_layernorm`: 16x16x1152 (`docs/architecture.md#encoders`). That norm
//! and the head are loaded to be counted and checked, but not used.
//!
//! The configuration is Hugging Face's config.json as it is, that of the vision tower or that of
//! both with the former under `vision_config`. Names are Hugging Face's (`vision_model.*`); text
//! tower and logit scale beside it are ignored.

use candle_core::{DType, Tensor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::preprocess::{Normalisation, resize_bicubic};
use super::{Block, Mlp, PatchEmbedding, Projections, SelfAttention};
use crate::Result;
use crate::cost::{self, Cost};
use crate::kinds::encoder::{Apply, EncoderConfig, apply};
use crate::layers::Activation;
use crate::loader::Loader;
use crate::sizes::{check_counts, check_multiple, check_sizes};

/// Sizes of the vision tower, with the names and the defaults of Hugging Face's
/// `SiglipVisionConfig`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self", default)]
pub(crate) struct SiglipVisionConfig {
    /// Width of the tokens.
    pub(crate) hidden_size: usize,
    /// Hidden width of the feed-forward networks.
    pub(crate) intermediate_size: usize,
    /// Number of blocks.
    pub(crate) num_hidden_layers: usize,
    /// Attention heads.
    pub(crate) num_attention_heads: usize,
    /// Colour channels; 3 is all that can be built.
    pub(crate) num_channels: usize,
    /// Side in pixels of the picture that is encoded.
    pub(crate) image_size: usize,
    /// Side of a patch in pixels.
    pub(crate) patch_size: usize,
    /// Activation of the feed-forward networks.
    pub(crate) hidden_act: Activation,
    /// Epsilon of every LayerNorm.
    pub(crate) layer_norm_eps: f64,
    /// Whether the checkpoint holds the attention pooling head, which the feature does not pass.
    pub(crate) vision_use_head: bool,
}

impl Default for SiglipVisionConfig {
    fn default() -> Self {
        Self {
            hidden_size: 768,
            intermediate_size: 3072,
            num_hidden_layers: 12,
            num_attention_heads: 12,
            num_channels: 3,
            image_size: 224,
            patch_size: 16,
            hidden_act: Activation::GeluTanh,
            layer_norm_eps: 1e-6,
            vision_use_head: true,
        }
    }
}

impl<'de> Deserialize<'de> for SiglipVisionConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let value = nested(deserializer, "vision_config")?;
        Self::deserialize(value).map_err(serde::de::Error::custom)
    }
}

impl Serialize for SiglipVisionConfig {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

/// The JSON object under `key`, or the whole object if it has no such key.
pub(super) fn nested<'de, D: Deserializer<'de>>(
    deserializer: D,
    key: &str,
) -> std::result::Result<serde_json::Value, D::Error> {
    let mut whole = serde_json::Map::deserialize(deserializer)?;
    Ok(match whole.remove(key) {
        Some(inner) => inner,
        None => serde_json::Value::Object(whole),
    })
}

impl SiglipVisionConfig {
    /// `google/siglip2-so400m-patch14-224`.
    pub(crate) fn so400m() -> Self {
        Self {
            hidden_size: 1152,
            intermediate_size: 4304,
            num_hidden_layers: 27,
            num_attention_heads: 16,
            patch_size: 14,
            ..Self::default()
        }
    }

    /// Patches along one side of the picture.
    pub(crate) fn grid(&self) -> usize {
        self.image_size / self.patch_size.max(1)
    }

    fn validate(&self) -> Result<()> {
        check_sizes(&[
            ("hidden_size", self.hidden_size),
            ("intermediate_size", self.intermediate_size),
            ("num_attention_heads", self.num_attention_heads),
            ("image_size", self.image_size),
            ("patch_size", self.patch_size),
        ])?;
        check_counts(&[("num_hidden_layers", self.num_hidden_layers)])?;
        if self.num_channels != 3 {
            let reason = format!("{}, expected 3", self.num_channels);
            return Err(wm_model::Error::config("num_channels", reason).into());
        }
        check_multiple(
            ("hidden_size", self.hidden_size),
            ("num_attention_heads", self.num_attention_heads),
        )?;
        check_multiple(
            ("image_size", self.image_size),
            ("patch_size", self.patch_size),
        )
    }

    fn layer(&self) -> LayerSizes {
        LayerSizes {
            width: self.hidden_size,
            mlp: self.intermediate_size,
            heads: self.num_attention_heads,
            activation: self.hidden_act,
            eps: self.layer_norm_eps,
        }
    }
}

impl EncoderConfig for SiglipVisionConfig {
    fn load(&self, loader: &Loader<'_>) -> Result<Apply> {
        Ok(apply(
            SiglipVision::load(self, loader)?,
            SiglipVision::encode,
        ))
    }

    fn features(&self, _: [usize; 2]) -> Result<[usize; 3]> {
        Ok([self.grid(), self.grid(), self.hidden_size])
    }

    fn cost(&self) -> Result<Cost> {
        cost::siglip2(self)
    }
}

/// The vision tower.
#[derive(Clone, Debug)]
pub(crate) struct SiglipVision {
    config: SiglipVisionConfig,
    patches: PatchEmbedding,
    /// (patches, hidden).
    positions: Tensor,
    blocks: Vec<Block>,
}

impl SiglipVision {
    /// Loads the vision tower.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub(crate) fn load(config: &SiglipVisionConfig, loader: &Loader<'_>) -> Result<Self> {
        config.validate()?;
        for prefix in ["text_model.", "logit_scale", "logit_bias"] {
            loader.ignore(prefix);
        }
        let loader = tower(loader, "vision_model", "embeddings.patch_embedding.weight");
        // Old files hold the numbers 0, 1, 2, ...
        loader.ignore("embeddings.position_ids");
        let (width, grid) = (config.hidden_size, config.grid());
        let patches = PatchEmbedding::load(
            &loader,
            "embeddings.patch_embedding",
            (width, config.patch_size),
            None,
        )?;
        let positions = "embeddings.position_embedding.weight";
        let positions = loader.tensor(positions, &[grid * grid, width])?;
        let blocks = layers(&config.layer(), config.num_hidden_layers, &loader)?;
        loader.layer_norm("post_layernorm", width, config.layer_norm_eps)?;
        if config.vision_use_head {
            check_head(config, &loader.at("head"))?;
        } else {
            loader.ignore("head.");
        }
        Ok(Self {
            config: config.clone(),
            patches,
            positions,
            blocks,
        })
    }

    /// Encodes `image` (N, H, W, 3), f32 in 0..1, to (N, grid, grid, hidden), f32.
    ///
    /// The picture is resized to the configuration's size (bicubic, not clamped) and taken from
    /// 0..1 to -1..1.
    ///
    /// # Errors
    /// If the picture has another shape.
    pub(crate) fn encode(&self, image: &Tensor) -> Result<Tensor> {
        let image = resize_bicubic(image, self.config.image_size)?;
        let patches = self.patches.forward(&Normalisation::HALF.apply(&image)?)?;
        let mut x = patches.broadcast_add(&self.positions)?;
        for block in &self.blocks {
            x = block.forward(&x, None, None)?;
        }
        let (n, grid) = (image.dim(0)?, self.config.grid());
        let feature = x.to_dtype(DType::F32)?;
        Ok(feature.reshape((n, grid, grid, self.config.hidden_size))?)
    }
}

/// The tower called `name`, whether the file holds it under that name or by itself, which is told
/// by the tensor `witness`.
pub(super) fn tower<'a>(loader: &Loader<'a>, name: &str, witness: &str) -> Loader<'a> {
    if loader.has(witness) {
        loader.clone()
    } else {
        loader.at(name)
    }
}

/// Asks for the tensors of the attention pooling head, and drops them.
fn check_head(config: &SiglipVisionConfig, loader: &Loader<'_>) -> Result<()> {
    let (width, mlp) = (config.hidden_size, config.intermediate_size);
    loader.tensor("probe", &[1, 1, width])?;
    loader.tensor("attention.in_proj_weight", &[3 * width, width])?;
    loader.tensor("attention.in_proj_bias", &[3 * width])?;
    loader.tensor("attention.out_proj.weight", &[width, width])?;
    loader.tensor("attention.out_proj.bias", &[width])?;
    loader.tensor("layernorm.weight", &[width])?;
    loader.tensor("layernorm.bias", &[width])?;
    loader.tensor("mlp.fc1.weight", &[mlp, width])?;
    loader.tensor("mlp.fc1.bias", &[mlp])?;
    loader.tensor("mlp.fc2.weight", &[width, mlp])?;
    loader.tensor("mlp.fc2.bias", &[width])?;
    Ok(())
}

/// Sizes of a layer of either tower.
pub(super) struct LayerSizes {
    pub(super) width: usize,
    pub(super) mlp: usize,
    pub(super) heads: usize,
    pub(super) activation: Activation,
    pub(super) eps: f64,
}

/// The layers of either tower, `encoder.layers.{i}`.
pub(super) fn layers(sizes: &LayerSizes, depth: usize, loader: &Loader<'_>) -> Result<Vec<Block>> {
    (0..depth)
        .map(|i| layer(sizes, &loader.at(format!("encoder.layers.{i}"))))
        .collect()
}

fn layer(sizes: &LayerSizes, loader: &Loader<'_>) -> Result<Block> {
    let (width, mlp) = (sizes.width, sizes.mlp);
    let projection = |name: &str| loader.linear(&format!("self_attn.{name}_proj"), width, width);
    let separate = [projection("q")?, projection("k")?, projection("v")?];
    Ok(Block {
        attention_norm: loader.layer_norm("layer_norm1", width, sizes.eps)?,
        attention: SelfAttention {
            projections: Projections::Separate(Box::new(separate)),
            out: projection("out")?,
            heads: sizes.heads,
            kernels: loader.kernels(),
        },
        attention_scale: None,
        mlp_norm: loader.layer_norm("layer_norm2", width, sizes.eps)?,
        mlp: Mlp::Plain {
            first: loader.linear("mlp.fc1", width, mlp)?,
            activation: sizes.activation,
            second: loader.linear("mlp.fc2", mlp, width)?,
        },
        mlp_scale: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;
    use wm_model::Kernels;

    #[test]
    fn so400m_has_the_published_size() {
        let loader = Loader::skeleton(Kernels::Candle);
        SiglipVision::load(&SiglipVisionConfig::so400m(), &loader).unwrap();
        assert_eq!(loader.parameters(), 427_680_704);
    }

    #[test]
    fn a_configuration_of_hugging_face_is_taken_as_it_is() {
        let vision = r#"{"hidden_size": 1152, "image_size": 224, "intermediate_size": 4304,
            "model_type": "siglip_vision_model", "num_attention_heads": 16,
            "num_hidden_layers": 27, "patch_size": 14, "attention_dropout": 0.0}"#;
        let both = format!(
            r#"{{"architectures": ["SiglipModel"], "initializer_factor": 1.0,
                "model_type": "siglip", "text_config": {{"hidden_size": 5}},
                "vision_config": {vision}}}"#
        );
        for json in [vision, &both] {
            let config: SiglipVisionConfig = serde_json::from_str(json).unwrap();
            assert_eq!(config, SiglipVisionConfig::so400m());
        }
        let again = serde_json::to_string(&SiglipVisionConfig::so400m()).unwrap();
        let config: SiglipVisionConfig = serde_json::from_str(&again).unwrap();
        assert_eq!(config, SiglipVisionConfig::so400m());
        let fault = r#"{"vision_config": {"hidden_act": "relu"}}"#;
        let fault = serde_json::from_str::<SiglipVisionConfig>(fault).unwrap_err();
        assert!(fault.to_string().contains("relu"), "{fault}");
    }

    #[test]
    fn a_small_one_has_the_shape_of_its_configuration() {
        let config = SiglipVisionConfig {
            hidden_size: 32,
            intermediate_size: 50,
            num_hidden_layers: 2,
            num_attention_heads: 4,
            image_size: 28,
            patch_size: 7,
            ..SiglipVisionConfig::default()
        };
        let model = SiglipVision::load(&config, &Loader::skeleton(Kernels::Candle)).unwrap();
        let image = Tensor::zeros((2, 256, 256, 3), DType::F32, &Device::Cpu).unwrap();
        assert_eq!(model.encode(&image).unwrap().dims(), [2, 4, 4, 32]);
    }
}
