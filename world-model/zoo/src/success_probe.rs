//! The success probe: whether an episode's latents show what the instruction asks for.
//!
//! Paper: appendix B.7, "VLA success classifier probe"; layer by layer in `docs/architecture.md#success-probe`. It
//! reads a whole episode of an encoder's latents, pooled to 4x4 tokens a frame, and the features of the instruction's
//! tokens (`vit/siglip_text.rs`), and gives one logit. [`SuccessClassifier`] is all of it together: words and
//! latents in, a probability out.
//!
//! Each block is attention within a frame, attention over time at each place, attention to the text and a SwiGLU
//! feed-forward network, each behind an RMSNorm and added to its input. Queries and keys are normalised per head as in
//! the transition model.
//!
//! The published probe carries a CLS token along. Only cross-attention and feed-forward network reach it, nothing reads
//! it, and the readout is the mean of the patch tokens: it has no effect, so it is checked to be in the file and not
//! computed.
//!
//! Norms carry no weights (unless `affine_norms` says so); epsilon 1e-6, and PyTorch's default, machine epsilon, for
//! queries and keys.
//!
//! Names in the authors' release: `input_proj.*`, `text_proj.*`, `cls_token` (1, 1, hidden), `temporal_embed` (1,
//! max_frames, 1, hidden), `spatial_embed` (1, 1, pool * pool, hidden),
//! `blocks.{i}.{spatial_attn,temporal_attn,cross_attn}.{q_proj,k_proj,v_proj,out_proj}.weight`,
//! `blocks.{i}.ffn.{w12,w3}.*`, `head.*`. A file without `q_proj` is read by shorter names: no `cls_token`,
//! `temporal_embed` (max_frames, hidden), `spatial_embed` (pool * pool, hidden), `{q,k,v,out}.weight`. With
//! `affine_norms` there are also `input_norm.weight`, `text_norm.weight`, `norm.weight`, `blocks.{i}.norm{1-4}.weight`
//! and `q_norm.weight`, `k_norm.weight` beside each query and key.
//!
//! Configuration (JSON; all but the first two have defaults): `{"features": 1024, "max_frames": 64,
//! "text_features": 1152, "pool": 4, "hidden": 384, "depth": 6, "heads": 8, "ffn": 1024,
//! "affine_norms": false}`. `max_frames` is the length of the published `temporal_embed`.

mod block;
mod classifier;
mod config;
mod grounded;
mod names;
mod network;
mod norm;
mod tokenizer;
mod trained;
mod words;

use candle_core::{DType, Tensor};

pub(crate) use classifier::{Instructed, Judge};
pub use classifier::{Instruction, Reader, Reading, SuccessClassifier};
pub use config::SuccessProbeConfig;
pub use grounded::{Answers, Asked, GroundedProbe, GroundedProbeConfig, Seen};
pub use network::{ProbeNetwork, ProbeNetworkConfig};
pub use tokenizer::InstructionTokenizer;
pub use trained::{PROBE_KEY, TEXT_TOWER_KEY, WORDS_KEY};
pub use words::{PLACE_FEATURES, WORD_FEATURES, WordEmbedding, WordsConfig, words};

use crate::Result;
use crate::layers::{Dropout, Linear};
use crate::loader::Loader;
use crate::sizes::shape_error;
use crate::vit::resample::{AxisWeights, resample};
use crate::vit::siglip_text::additive_mask;
use block::ProbeBlock;
use names::Names;
use norm::RmsNorm;

/// The success probe.
#[derive(Clone, Debug)]
pub struct SuccessProbe {
    config: SuccessProbeConfig,
    input_norm: RmsNorm,
    input: Linear,
    /// (max_frames, 1, hidden).
    temporal: Tensor,
    /// (1, pool * pool, hidden).
    spatial: Tensor,
    text: Linear,
    text_norm: RmsNorm,
    blocks: Vec<ProbeBlock>,
    norm: RmsNorm,
    head: Linear,
}

impl SuccessProbe {
    /// Loads the probe.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &SuccessProbeConfig, loader: &Loader<'_>) -> Result<Self> {
        config.validate()?;
        let (width, frames) = (config.hidden, config.max_frames);
        let places = config.pool * config.pool;
        let norm = |name: &str, width: usize| RmsNorm::load(config, loader, name, width);
        let names = Names::of(loader);
        if names == Names::Published {
            // Without effect, see the module; asked for so that a file without it is no published probe.
            loader.tensor("cls_token", &[1, 1, width])?;
        }
        Ok(Self {
            config: config.clone(),
            input_norm: norm("input_norm", config.features)?,
            input: loader
                .sensitive()
                .linear("input_proj", config.features, width)?,
            temporal: loader
                .tensor("temporal_embed", &names.temporal(frames, width))?
                .reshape((frames, 1, width))?,
            spatial: loader
                .tensor("spatial_embed", &names.spatial(places, width))?
                .reshape((1, places, width))?,
            text: loader
                .sensitive()
                .linear("text_proj", config.text_features, width)?,
            text_norm: norm("text_norm", width)?,
            blocks: (0..config.depth)
                .map(|i| ProbeBlock::load(config, names, &loader.at(format!("blocks.{i}"))))
                .collect::<Result<_>>()?,
            norm: norm("norm", width)?,
            head: loader.sensitive().linear("head", width, 1)?,
        })
    }

    /// The configuration.
    pub fn config(&self) -> &SuccessProbeConfig {
        &self.config
    }

    /// The logit of success (B), f32, of episodes of `latents` (B, T, h, w, features) under
    /// instructions `text` (B, L, text features); `text_mask` (B, L) is 1 for tokens and 0 for
    /// padding, and without it all are seen.
    ///
    /// # Errors
    /// If the shapes do not fit, or the episode is longer than the configuration allows.
    pub fn forward(
        &self,
        latents: &Tensor,
        text: &Tensor,
        text_mask: Option<&Tensor>,
    ) -> Result<Tensor> {
        self.forward_dropping(latents, text, text_mask, &mut Dropout::none())
    }

    /// The same in training, with dropout of what each part of a block adds (the paper: 0.1).
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn forward_dropping(
        &self,
        latents: &Tensor,
        text: &Tensor,
        text_mask: Option<&Tensor>,
        dropout: &mut Dropout<'_>,
    ) -> Result<Tensor> {
        let (b, t) = self.check_latents(latents)?;
        let text = self.text_tokens(text, b)?;
        let mask = text_mask
            .map(|mask| additive_mask(mask, (b, text.dim(1)?), &text))
            .transpose()?;
        let width = self.config.hidden;
        let latents = latents.to_device(text.device())?;
        let pooled = self.pool(&latents)?.to_dtype(text.dtype())?;
        let mut x = self
            .input
            .forward(&self.input_norm.forward(&pooled)?)?
            .broadcast_add(&self.temporal.narrow(0, 0, t)?)?
            .broadcast_add(&self.spatial)?;
        for block in &self.blocks {
            x = block.forward(&x, &text, mask.as_ref(), dropout)?;
        }
        let tokens = self.norm.forward(&x)?.reshape((b, (), width))?;
        let mean = tokens
            .to_dtype(DType::F32)?
            .mean(1)?
            .to_dtype(text.dtype())?;
        Ok(self.head.forward(&mean)?.to_dtype(DType::F32)?.squeeze(1)?)
    }

    /// (B, T, h, w, C) to (B, T, pool * pool, C) by adaptive averaging, f32.
    fn pool(&self, latents: &Tensor) -> Result<Tensor> {
        let (b, t, h, w, c) = latents.dims5()?;
        let pool = self.config.pool;
        let rows = AxisWeights::adaptive_average(h, pool);
        let columns = AxisWeights::adaptive_average(w, pool);
        let pooled = resample(&latents.reshape((b * t, h, w, c))?, &rows, &columns)?;
        Ok(pooled.reshape((b, t, pool * pool, c))?)
    }

    /// (B, L, text features) to (B, L, hidden).
    fn text_tokens(&self, text: &Tensor, batch: usize) -> Result<Tensor> {
        match text.dims() {
            &[b, l, c] if b == batch && l > 0 && c == self.config.text_features => {}
            _ => {
                let expected = format!("({batch}, L, {})", self.config.text_features);
                return Err(shape_error("the text", expected, text));
            }
        }
        let text = text.to_device(self.temporal.device())?;
        let text = text.to_dtype(self.temporal.dtype())?;
        self.text_norm.forward(&self.text.forward(&text)?)
    }

    /// Batch and frames of latents that fit.
    fn check_latents(&self, latents: &Tensor) -> Result<(usize, usize)> {
        let (most, features) = (self.config.max_frames, self.config.features);
        match latents.dims() {
            &[b, t, h, w, c] if c == features && t > 0 && t <= most && h > 0 && w > 0 => Ok((b, t)),
            _ => {
                let expected = format!("(B, T, h, w, {features}) with T from 1 to {most}");
                Err(shape_error("the latents", expected, latents))
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use candle_core::Device;
    use wm_model::Kernels;

    /// A tokenizer.json of eleven words, in the form of Gemma's but for its model.
    pub(crate) const TOKENIZER: &str = include_str!("success_probe/tokenizer/words.json");

    fn small(affine_norms: bool) -> SuccessProbeConfig {
        SuccessProbeConfig {
            text_features: 12,
            pool: 2,
            hidden: 16,
            depth: 2,
            heads: 2,
            ffn: 20,
            affine_norms,
            ..SuccessProbeConfig::paper(6, 5)
        }
    }

    #[test]
    fn a_small_one_gives_a_logit_an_episode() {
        for affine in [false, true] {
            let loader = Loader::skeleton(Kernels::Candle);
            let probe = SuccessProbe::load(&small(affine), &loader).unwrap();
            let latents = Tensor::ones((3, 4, 5, 7, 6), DType::F32, &Device::Cpu).unwrap();
            let text = Tensor::ones((3, 2, 12), DType::F32, &Device::Cpu).unwrap();
            let mask = Tensor::new(&[[1_u32, 0], [1, 1], [1, 0]], &Device::Cpu).unwrap();
            let logit = probe.forward(&latents, &text, Some(&mask)).unwrap();
            assert_eq!(logit.dims(), [3]);
            assert_eq!(probe.forward(&latents, &text, None).unwrap().dims(), [3]);
        }
    }

    #[test]
    fn parameters_are_those_of_the_description() {
        let loader = Loader::skeleton(Kernels::Candle);
        SuccessProbe::load(&SuccessProbeConfig::paper(1024, 64), &loader).unwrap();
        let d = 384;
        let block = 3 * 4 * d * d + (d * 2048 + 2048) + (1024 * d + d);
        let outside = (1024 * d + d) + (64 + 16) * d + (1152 * d + d) + (d + 1);
        assert_eq!(loader.parameters(), 6 * block + outside);
    }

    #[test]
    fn an_episode_too_long_is_refused() {
        let loader = Loader::skeleton(Kernels::Candle);
        let probe = SuccessProbe::load(&small(false), &loader).unwrap();
        let latents = Tensor::zeros((1, 6, 4, 4, 6), DType::F32, &Device::Cpu).unwrap();
        let text = Tensor::zeros((1, 2, 12), DType::F32, &Device::Cpu).unwrap();
        let message = probe
            .forward(&latents, &text, None)
            .unwrap_err()
            .to_string();
        assert!(message.contains("from 1 to 5"), "{message}");
    }
}
