//! S-VAE: the adapter that takes the features of a frozen encoder to a compact latent and back.
//!
//! Paper: section "Adapter" of the appendix, after "Both Semantics and Reconstruction Matter"
//! (Zhang et al. 2025); layer by layer in `docs/architecture.md#adapter`. 38.110 M parameters for
//! features of 1024, 46.412 M for 1152, encoder and decoder together. (The paper's text says 12
//! heads and a feed-forward width of 3072; its table of sizes asks for 16 and 1024.)
//!
//! Tokens of one picture go through pre-norm blocks without any position; then per token a
//! diagonal Gaussian, of which the world model uses the mean. The decoder mirrors it. There is no
//! sampling and no loss here.
//!
//! Names: `enc_blocks.{i}.attention.attention.{query,key,value}.*`,
//! `enc_blocks.{i}.attention.output.dense.*`, `enc_blocks.{i}.intermediate.dense.*`,
//! `enc_blocks.{i}.output.dense.*`, `enc_blocks.{i}.layernorm_{before,after}.*`, `enc_norm.*`,
//! `enc_proj.*`, `dec_proj.*`, `dec_blocks.{i}.*`, `dec_norm.*`.
//!
//! Configuration (JSON): `{"features": 1024, "latent": 96, "heads": 16, "layers": 3, "ffn": 1024}`.

use candle_core::{D, DType, Device, Tensor};
use serde::{Deserialize, Serialize};

use crate::Result;
use crate::layers::{Activation, LayerNorm, Linear};
use crate::loader::Loader;
use crate::sizes::{check_counts, check_multiple, check_sizes, shape_error};
use crate::vit::{Block, Mlp, Projections, SelfAttention};

/// Epsilon of the LayerNorms in the blocks.
const BLOCK_EPS: f64 = 1e-12;
/// Epsilon of the LayerNorms behind the blocks.
const FINAL_EPS: f64 = 1e-5;

/// Sizes of the adapter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SvaeConfig {
    /// Channels of the encoder's features.
    pub features: usize,
    /// Channels of the latent.
    pub latent: usize,
    /// Attention heads.
    pub heads: usize,
    /// Blocks of the encoder, and as many of the decoder.
    pub layers: usize,
    /// Hidden width of the feed-forward networks.
    pub ffn: usize,
}

impl SvaeConfig {
    /// The paper's adapter to 96 channels, for features of V-JEPA 2.1 and Web-DINO (1024) or of
    /// SigLIP 2 (1152).
    pub fn paper(features: usize) -> Self {
        Self {
            features,
            latent: 96,
            heads: 16,
            layers: 3,
            ffn: 1024,
        }
    }

    fn validate(&self) -> Result<()> {
        check_sizes(&[
            ("features", self.features),
            ("latent", self.latent),
            ("heads", self.heads),
            ("ffn", self.ffn),
        ])?;
        check_counts(&[("layers", self.layers)])?;
        check_multiple(("features", self.features), ("heads", self.heads))
    }
}

/// The adapter.
#[derive(Clone, Debug)]
pub struct Svae {
    config: SvaeConfig,
    dtype: DType,
    device: Device,
    encoder_blocks: Vec<Block>,
    encoder_norm: LayerNorm,
    to_latent: Linear,
    from_latent: Linear,
    decoder_blocks: Vec<Block>,
    decoder_norm: LayerNorm,
}

impl Svae {
    /// Loads the adapter.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &SvaeConfig, loader: &Loader<'_>) -> Result<Self> {
        config.validate()?;
        let (width, latent) = (config.features, config.latent);
        let blocks = |name: &str| {
            (0..config.layers)
                .map(|i| block(config, &loader.at(format!("{name}.{i}"))))
                .collect::<Result<Vec<_>>>()
        };
        Ok(Self {
            config: config.clone(),
            dtype: loader.dtype(),
            device: loader.device().clone(),
            encoder_blocks: blocks("enc_blocks")?,
            encoder_norm: loader.layer_norm("enc_norm", width, FINAL_EPS)?,
            to_latent: loader.sensitive().linear("enc_proj", width, 2 * latent)?,
            from_latent: loader.sensitive().linear("dec_proj", latent, width)?,
            decoder_blocks: blocks("dec_blocks")?,
            decoder_norm: loader.layer_norm("dec_norm", width, FINAL_EPS)?,
        })
    }

    /// The configuration.
    pub fn config(&self) -> &SvaeConfig {
        &self.config
    }

    /// Features (N, h, w, features) to the latent's mean (N, h, w, latent), f32.
    ///
    /// # Errors
    /// If the features have another shape.
    pub fn encode(&self, features: &Tensor) -> Result<Tensor> {
        Ok(self.encode_distribution(features)?.0)
    }

    /// Features (N, h, w, features) to mean and logarithm of the variance of the latent, each
    /// (N, h, w, latent), f32.
    ///
    /// # Errors
    /// If the features have another shape.
    pub fn encode_distribution(&self, features: &Tensor) -> Result<(Tensor, Tensor)> {
        let (n, h, w) = grid_of(features, "the features", self.config.features)?;
        let tokens = self.tokens(features, (n, h * w, self.config.features))?;
        let x = run(&self.encoder_blocks, &tokens)?;
        let both = self.to_latent.forward(&self.encoder_norm.forward(&x)?)?;
        let latent = self.config.latent;
        let both = both.to_dtype(DType::F32)?.reshape((n, h, w, 2 * latent))?;
        let part = |start: usize| both.narrow(D::Minus1, start, latent)?.contiguous();
        Ok((part(0)?, part(latent)?))
    }

    /// A latent (N, h, w, latent) to features (N, h, w, features), f32.
    ///
    /// # Errors
    /// If the latent has another shape.
    pub fn decode(&self, latent: &Tensor) -> Result<Tensor> {
        let (n, h, w) = grid_of(latent, "the latent", self.config.latent)?;
        let tokens = self.tokens(latent, (n, h * w, self.config.latent))?;
        let x = self.from_latent.forward(&tokens)?;
        let x = self.decoder_norm.forward(&run(&self.decoder_blocks, &x)?)?;
        let x = x.to_dtype(DType::F32)?;
        Ok(x.reshape((n, h, w, self.config.features))?)
    }

    /// The reconstruction of features from the mean of their latent, shapes as in
    /// [`Svae::encode`].
    ///
    /// # Errors
    /// If the features have another shape.
    pub fn forward(&self, features: &Tensor) -> Result<Tensor> {
        self.decode(&self.encode(features)?)
    }

    /// `x` as the blocks take it.
    fn tokens(&self, x: &Tensor, shape: (usize, usize, usize)) -> Result<Tensor> {
        let x = x.to_device(&self.device)?.to_dtype(self.dtype)?;
        Ok(x.reshape(shape)?.contiguous()?)
    }
}

fn grid_of(x: &Tensor, what: &'static str, channels: usize) -> Result<(usize, usize, usize)> {
    match x.dims() {
        &[n, h, w, c] if c == channels => Ok((n, h, w)),
        _ => Err(shape_error(what, format!("(N, h, w, {channels})"), x)),
    }
}

fn run(blocks: &[Block], tokens: &Tensor) -> Result<Tensor> {
    let mut x = tokens.clone();
    for block in blocks {
        x = block.forward(&x, None, None)?;
    }
    Ok(x)
}

fn block(config: &SvaeConfig, loader: &Loader<'_>) -> Result<Block> {
    let width = config.features;
    let projection =
        |name: &str| loader.linear(&format!("attention.attention.{name}"), width, width);
    let separate = [
        projection("query")?,
        projection("key")?,
        projection("value")?,
    ];
    Ok(Block {
        attention_norm: loader.layer_norm("layernorm_before", width, BLOCK_EPS)?,
        attention: SelfAttention {
            projections: Projections::Separate(Box::new(separate)),
            out: loader.linear("attention.output.dense", width, width)?,
            heads: config.heads,
            kernels: loader.kernels(),
        },
        attention_scale: None,
        mlp_norm: loader.layer_norm("layernorm_after", width, BLOCK_EPS)?,
        mlp: Mlp::Plain {
            first: loader.linear("intermediate.dense", width, config.ffn)?,
            activation: Activation::GeluExact,
            second: loader.linear("output.dense", config.ffn, width)?,
        },
        mlp_scale: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_model::Kernels;

    #[test]
    fn the_papers_adapters_have_the_published_sizes() {
        for (features, parameters) in [(1024, 38_110_400), (1152, 46_412_352)] {
            let loader = Loader::skeleton(Kernels::Candle);
            Svae::load(&SvaeConfig::paper(features), &loader).unwrap();
            assert_eq!(loader.parameters(), parameters);
        }
    }

    #[test]
    fn a_small_one_has_the_shape_of_its_configuration() {
        let json = r#"{"features": 32, "latent": 6, "heads": 4, "layers": 2, "ffn": 20}"#;
        let config: SvaeConfig = serde_json::from_str(json).unwrap();
        let model = Svae::load(&config, &Loader::skeleton(Kernels::Candle)).unwrap();
        let features = Tensor::zeros((2, 3, 5, 32), DType::F32, &Device::Cpu).unwrap();
        assert_eq!(model.encode(&features).unwrap().dims(), [2, 3, 5, 6]);
        assert_eq!(model.forward(&features).unwrap().dims(), [2, 3, 5, 32]);
        let message = model.decode(&features).unwrap_err().to_string();
        assert!(message.contains("(N, h, w, 6)"), "{message}");
    }

    #[test]
    fn heads_that_do_not_divide_are_named() {
        let config = SvaeConfig {
            heads: 12,
            ..SvaeConfig::paper(1024)
        };
        let fault = Svae::load(&config, &Loader::skeleton(Kernels::Candle)).unwrap_err();
        assert!(fault.to_string().contains("heads = 12"), "{fault}");
    }
}
