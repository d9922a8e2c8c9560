//! Web-DINO, or any other encoder of the Dinov2 family.
//!
//! Paper: "Scaling Language-Free Visual Representation Learning" (arXiv 2504.01017); checkpoint
//! <https://huggingface.co/facebook/webssl-dino300m-full2b-224>, a Hugging Face `Dinov2Model`:
//! ViT-L/14 with SwiGLU at 224x224, 303.655 M parameters with the mask token. The feature is the
//! last hidden state behind the final LayerNorm without CLS: 16x16x1024 (`docs/architecture.md#encoders`).
//!
//! The configuration is Hugging Face's config.json as it is; keys that do not concern inference
//! are ignored. Names are Hugging Face's (`embeddings.*`, `encoder.layer.{i}.*`, `layernorm.*`),
//! possibly under `dinov2.`.

use candle_core::{DType, Tensor};
use serde::{Deserialize, Serialize};

use super::preprocess::{Normalisation, resize_bicubic};
use super::{Block, Mlp, PatchEmbedding, Projections, SelfAttention};
use crate::Result;
use crate::cost::{self, Cost};
use crate::kinds::encoder::{Apply, EncoderConfig, apply};
use crate::layers::{Activation, LayerNorm};
use crate::loader::Loader;
use crate::sizes::{check_counts, check_multiple, check_sizes};

/// Sizes of the encoder, with the names and the defaults of Hugging Face's `Dinov2Config`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct WebDinoConfig {
    /// Width of the tokens.
    pub hidden_size: usize,
    /// Number of blocks.
    pub num_hidden_layers: usize,
    /// Attention heads.
    pub num_attention_heads: usize,
    /// Hidden width of the feed-forward networks over that of the tokens, before SwiGLU takes two
    /// thirds of it.
    pub mlp_ratio: f64,
    /// Activation of the feed-forward networks that are not SwiGLU.
    pub hidden_act: Activation,
    /// Epsilon of every LayerNorm.
    pub layer_norm_eps: f64,
    /// Side in pixels of the picture that is encoded.
    pub image_size: usize,
    /// Side of a patch in pixels.
    pub patch_size: usize,
    /// Colour channels; 3 is all that can be built.
    pub num_channels: usize,
    /// Whether the projections to queries, keys and values have a bias.
    pub qkv_bias: bool,
    /// Whether the feed-forward networks are SwiGLU.
    pub use_swiglu_ffn: bool,
    /// Whether the checkpoint holds a mask token, which inference does not use.
    pub use_mask_token: bool,
}

impl Default for WebDinoConfig {
    fn default() -> Self {
        Self {
            hidden_size: 768,
            num_hidden_layers: 12,
            num_attention_heads: 12,
            mlp_ratio: 4.0,
            hidden_act: Activation::GeluExact,
            layer_norm_eps: 1e-6,
            image_size: 224,
            patch_size: 14,
            num_channels: 3,
            qkv_bias: true,
            use_swiglu_ffn: false,
            use_mask_token: true,
        }
    }
}

impl WebDinoConfig {
    /// ViT-L/14 of `facebook/webssl-dino300m-full2b-224`.
    pub(crate) fn vit_large() -> Self {
        Self {
            hidden_size: 1024,
            num_hidden_layers: 24,
            num_attention_heads: 16,
            use_swiglu_ffn: true,
            ..Self::default()
        }
    }

    /// Hidden width of the feed-forward networks (2736 for SwiGLU at width 1024).
    pub(crate) fn mlp_width(&self) -> usize {
        // Truncations as in Python's int().
        let plain = (self.hidden_size as f64 * self.mlp_ratio) as usize;
        if self.use_swiglu_ffn {
            ((plain as f64 * 2.0 / 3.0) as usize).next_multiple_of(8)
        } else {
            plain
        }
    }

    /// Patches along one side of the picture.
    pub fn grid(&self) -> usize {
        self.image_size / self.patch_size.max(1)
    }

    fn validate(&self) -> Result<()> {
        check_sizes(&[
            ("hidden_size", self.hidden_size),
            ("num_attention_heads", self.num_attention_heads),
            ("mlp_ratio", self.mlp_width()),
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
}

impl EncoderConfig for WebDinoConfig {
    fn load(&self, loader: &Loader<'_>) -> Result<Apply> {
        Ok(apply(WebDino::load(self, loader)?, WebDino::encode))
    }

    fn features(&self, _: [usize; 2]) -> Result<[usize; 3]> {
        Ok([self.grid(), self.grid(), self.hidden_size])
    }

    fn cost(&self) -> Result<Cost> {
        cost::web_dino(self)
    }
}

/// The encoder.
#[derive(Clone, Debug)]
pub struct WebDino {
    config: WebDinoConfig,
    patches: PatchEmbedding,
    /// (1, 1, hidden).
    cls: Tensor,
    /// (1, 1 + patches, hidden), CLS first.
    positions: Tensor,
    blocks: Vec<Block>,
    norm: LayerNorm,
}

impl WebDino {
    /// Loads the encoder; a classifier beside it is ignored.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &WebDinoConfig, loader: &Loader<'_>) -> Result<Self> {
        config.validate()?;
        loader.ignore("classifier.");
        let loader = if loader.has("dinov2.embeddings.cls_token") {
            loader.at("dinov2")
        } else {
            loader.clone()
        };
        let width = config.hidden_size;
        if config.use_mask_token {
            loader.tensor("embeddings.mask_token", &[1, width])?;
        } else {
            loader.ignore("embeddings.mask_token");
        }
        let patches = PatchEmbedding::load(
            &loader,
            "embeddings.patch_embeddings.projection",
            (width, config.patch_size),
            None,
        )?;
        let tokens = 1 + config.grid() * config.grid();
        let blocks = (0..config.num_hidden_layers)
            .map(|i| block(config, &loader.at(format!("encoder.layer.{i}"))))
            .collect::<Result<_>>()?;
        Ok(Self {
            config: config.clone(),
            patches,
            cls: loader.tensor("embeddings.cls_token", &[1, 1, width])?,
            positions: loader.tensor("embeddings.position_embeddings", &[1, tokens, width])?,
            blocks,
            norm: loader.layer_norm("layernorm", width, config.layer_norm_eps)?,
        })
    }

    /// The configuration.
    pub fn config(&self) -> &WebDinoConfig {
        &self.config
    }

    /// Encodes `image` (N, H, W, 3), f32 in 0..1, to (N, grid, grid, hidden), f32.
    ///
    /// The picture is resized to the configuration's size (bicubic, not clamped) and normalised
    /// with ImageNet's mean and standard deviation.
    ///
    /// # Errors
    /// If the picture has another shape.
    pub fn encode(&self, image: &Tensor) -> Result<Tensor> {
        let image = resize_bicubic(image, self.config.image_size)?;
        let patches = self
            .patches
            .forward(&Normalisation::IMAGENET.apply(&image)?)?;
        let (n, tokens, width) = patches.dims3()?;
        let cls = self.cls.expand((n, 1, width))?;
        let mut x = Tensor::cat(&[&cls, &patches], 1)?.broadcast_add(&self.positions)?;
        for block in &self.blocks {
            x = block.forward(&x, None, None)?;
        }
        let feature = self.norm.forward(&x.narrow(1, 1, tokens)?.contiguous()?)?;
        let grid = self.config.grid();
        let feature = feature.to_dtype(DType::F32)?;
        Ok(feature.reshape((n, grid, grid, width))?)
    }
}

fn block(config: &WebDinoConfig, loader: &Loader<'_>) -> Result<Block> {
    let (width, mlp) = (config.hidden_size, config.mlp_width());
    let projection = |name: &str| {
        let name = format!("attention.attention.{name}");
        if config.qkv_bias {
            loader.linear(&name, width, width)
        } else {
            loader.linear_no_bias(&name, width, width)
        }
    };
    let separate = [
        projection("query")?,
        projection("key")?,
        projection("value")?,
    ];
    Ok(Block {
        attention_norm: loader.layer_norm("norm1", width, config.layer_norm_eps)?,
        attention: SelfAttention {
            projections: Projections::Separate(Box::new(separate)),
            out: loader.linear("attention.output.dense", width, width)?,
            heads: config.num_attention_heads,
            kernels: loader.kernels(),
        },
        attention_scale: Some(loader.tensor("layer_scale1.lambda1", &[width])?),
        mlp_norm: loader.layer_norm("norm2", width, config.layer_norm_eps)?,
        mlp: if config.use_swiglu_ffn {
            Mlp::SwiGlu {
                gate_and_value: loader.linear("mlp.weights_in", width, 2 * mlp)?,
                out: loader.linear("mlp.weights_out", mlp, width)?,
                kernels: loader.kernels(),
            }
        } else {
            Mlp::Plain {
                first: loader.linear("mlp.fc1", width, mlp)?,
                activation: config.hidden_act,
                second: loader.linear("mlp.fc2", mlp, width)?,
            }
        },
        mlp_scale: Some(loader.tensor("layer_scale2.lambda1", &[width])?),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;
    use wm_model::Kernels;

    #[test]
    fn vit_large_has_the_published_size() {
        let config = WebDinoConfig::vit_large();
        assert_eq!(config.mlp_width(), 2736);
        let loader = Loader::skeleton(Kernels::Candle);
        WebDino::load(&config, &loader).unwrap();
        assert_eq!(loader.parameters(), 303_655_168);
    }

    #[test]
    fn a_configuration_of_hugging_face_is_taken_as_it_is() {
        let json = r#"{
            "architectures": ["Dinov2Model"], "model_type": "dinov2", "torch_dtype": "float32",
            "hidden_size": 1024, "num_hidden_layers": 24, "num_attention_heads": 16,
            "mlp_ratio": 4, "hidden_act": "gelu", "layer_norm_eps": 1e-06, "image_size": 224,
            "patch_size": 14, "num_channels": 3, "qkv_bias": true, "layerscale_value": 1e-5,
            "drop_path_rate": 0.0, "use_swiglu_ffn": true, "out_features": ["stage24"]
        }"#;
        let config: WebDinoConfig = serde_json::from_str(json).unwrap();
        assert_eq!(config, WebDinoConfig::vit_large());
    }

    #[test]
    fn a_small_one_has_the_shape_of_its_configuration() {
        for use_swiglu_ffn in [true, false] {
            let config = WebDinoConfig {
                hidden_size: 32,
                num_hidden_layers: 2,
                num_attention_heads: 4,
                image_size: 28,
                patch_size: 7,
                use_swiglu_ffn,
                qkv_bias: use_swiglu_ffn,
                ..WebDinoConfig::default()
            };
            let model = WebDino::load(&config, &Loader::skeleton(Kernels::Candle)).unwrap();
            let image = Tensor::zeros((2, 256, 256, 3), DType::F32, &Device::Cpu).unwrap();
            assert_eq!(model.encode(&image).unwrap().dims(), [2, 4, 4, 32]);
        }
    }
}
