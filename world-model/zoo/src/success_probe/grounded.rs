//! A small success probe that looks for the things an instruction names.
//!
//! Not the paper's. That one averages a frame to 4x4 places, and learns from the outcome alone where the thing is that an
//! instruction is about: in a few thousand episodes of a simulator it finds out nothing. Here each instruction makes a few
//! queries, one for each thing that it mentions, and each query looks for its thing in some frames of the episode by
//! attention over all places. What is judged is where the things were in each frame and what was seen there. Where masks
//! tell the places of things, the attention is trained to point at them (grounding, as in arXiv 1812.03299); without, it
//! has to find out from the outcomes.
//!
//! `frames` frames, spread evenly from the first to the last, go through three 3x3 convolutions, of which the second and
//! the third add to their input, with GELU before both. Words are projected and, behind one token for each query and one
//! for the meaning of the whole, go through pre-norm transformer blocks. A query's attention to a place is its product with
//! the place's key, times 2 over the root of the width. Three linear layers with ReLU judge.
//!
//! Names: `convs.{i}.*`, `key.*`, `value.*`, `text_proj.*`, `text_tokens` (queries + 1, text width),
//! `text_blocks.{i}.*` as timm's blocks, `query.*`, `head.{0,1,2}.*`.

use candle_core::{D, DType, Device, Tensor};
use serde::{Deserialize, Serialize};
use wm_model::Kernels;

use crate::layers::{Conv2d, ConvSpec, Dropout, Linear, Padding, gelu_exact};
use crate::sizes::{check_counts, check_multiple, check_sizes, shape_error};
use crate::vit::siglip_text::additive_mask;
use crate::vit::{Block, BlockNames};
use crate::{Loader, Result};

/// Epsilon of the LayerNorms: PyTorch's default.
const LAYER_NORM_EPS: f64 = 1e-5;
/// Keeps the strength of an attention, a logarithm, among values of about one.
const STRENGTH_SCALE: f64 = 0.2;

/// Sizes of the grounded probe.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GroundedProbeConfig {
    /// Channels of the latents.
    pub features: usize,
    /// Rows and columns of the latents.
    pub grid: [usize; 2],
    /// Frames of the longest episode.
    pub max_frames: usize,
    /// Channels of the text's tokens.
    pub text_features: usize,
    /// Frames that are looked at.
    pub frames: usize,
    /// Channels of the convolutions.
    pub width: usize,
    /// Channels of a place's key and value.
    pub channels: usize,
    /// Things that are looked for.
    pub queries: usize,
    /// Width of the tokens of the text.
    pub text_width: usize,
    /// Blocks of the text.
    pub text_depth: usize,
    /// Attention heads of these.
    pub text_heads: usize,
    /// Width of the layers that judge.
    pub hidden: usize,
}

/// The grounded probe.
#[derive(Clone, Debug)]
pub struct GroundedProbe {
    config: GroundedProbeConfig,
    convs: [Conv2d; 3],
    key: Linear,
    value: Linear,
    text: Linear,
    /// (1, queries + 1, text width).
    tokens: Tensor,
    blocks: Vec<Block>,
    query: Linear,
    head: [Linear; 3],
    /// (places, 2): column and row, from -1 to 1.
    places: Tensor,
    kernels: Kernels,
}

/// What an episode shows.
#[derive(Clone, Debug)]
pub struct Seen {
    /// (frames, channels, places).
    keys: Tensor,
    /// (frames, places, channels and two coordinates).
    values: Tensor,
}

/// What an instruction asks for.
#[derive(Clone, Debug)]
pub struct Asked {
    /// (queries, channels).
    queries: Tensor,
    /// (1, text width).
    meaning: Tensor,
}

/// What is said of an episode under several instructions.
#[derive(Clone, Debug)]
pub struct Answers {
    /// Logits of success (instructions), f32.
    pub logits: Tensor,
    /// Logits of the attention (frames, instructions, queries, places), f32.
    pub attention: Tensor,
}

impl GroundedProbeConfig {
    fn validate(&self) -> Result<()> {
        let [rows, columns] = self.grid;
        check_sizes(&[
            ("features", self.features),
            ("grid", rows),
            ("grid", columns),
            ("max_frames", self.max_frames),
            ("text_features", self.text_features),
            ("frames", self.frames),
            ("width", self.width),
            ("channels", self.channels),
            ("queries", self.queries),
            ("text_width", self.text_width),
            ("text_heads", self.text_heads),
            ("hidden", self.hidden),
        ])?;
        check_counts(&[("text_depth", self.text_depth)])?;
        check_multiple(
            ("text_width", self.text_width),
            ("text_heads", self.text_heads),
        )
    }

    /// Which frames of `count` are looked at; a short episode's more than once.
    pub fn looked_at(&self, count: usize) -> Vec<usize> {
        let (last, steps) = (
            count.saturating_sub(1),
            self.frames.saturating_sub(1).max(1),
        );
        let frames = (0..self.frames).map(|step| (step * last + steps / 2) / steps);
        frames.collect()
    }
}

impl GroundedProbe {
    /// Loads the probe.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &GroundedProbeConfig, loader: &Loader<'_>) -> Result<Self> {
        config.validate()?;
        let c = config;
        let conv = |i: usize, inputs| {
            let spec = ConvSpec {
                inputs,
                outputs: c.width,
                kernel: 3,
                stride: 1,
                padding: Padding::same(3),
            };
            loader.conv2d(&format!("convs.{i}"), spec)
        };
        // Of each query in each frame: what was seen, where, and how clearly.
        let found = c.frames * c.queries * (c.channels + 3);
        let sizes = (c.text_width, c.text_heads, 2 * c.text_width);
        let block = |i| {
            let loader = loader.at(format!("text_blocks.{i}"));
            Block::load(&loader, &BlockNames::TIMM, sizes, LAYER_NORM_EPS)
        };
        let tokens = [c.queries + 1, c.text_width];
        Ok(Self {
            convs: [conv(0, c.features)?, conv(1, c.width)?, conv(2, c.width)?],
            key: loader.linear("key", c.width, c.channels)?,
            value: loader.linear("value", c.width, c.channels)?,
            text: loader.linear("text_proj", c.text_features, c.text_width)?,
            tokens: loader.tensor("text_tokens", &tokens)?.unsqueeze(0)?,
            blocks: (0..c.text_depth).map(block).collect::<Result<_>>()?,
            query: loader.linear("query", c.text_width, c.channels)?,
            head: [
                loader.linear("head.0", found + c.text_width, c.hidden)?,
                loader.linear("head.1", c.hidden, c.hidden)?,
                loader.linear("head.2", c.hidden, 1)?,
            ],
            places: places(c.grid, loader.device())?.to_dtype(loader.dtype())?,
            kernels: loader.kernels(),
            config: c.clone(),
        })
    }

    /// The configuration.
    pub fn config(&self) -> &GroundedProbeConfig {
        &self.config
    }

    /// Looks at an episode: latents (1, T, h, w, features).
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn look(&self, latents: &Tensor) -> Result<Seen> {
        let c = &self.config;
        let [rows, columns] = c.grid;
        let count = match latents.dims() {
            &[1, t, h, w, f] if t > 0 && [h, w, f] == [rows, columns, c.features] => t,
            _ => {
                let expected = format!("(1, T, {rows}, {columns}, {})", c.features);
                return Err(shape_error("the latents", expected, latents));
            }
        };
        let frames = c.looked_at(count).into_iter().map(|frame| frame as u32);
        let frames = Tensor::from_iter(frames, latents.device())?;
        let x = latents.squeeze(0)?.contiguous()?.index_select(&frames, 0)?;
        let x = x
            .to_device(self.places.device())?
            .to_dtype(self.places.dtype())?;
        let [first, second, third] = &self.convs;
        let x = gelu_exact(self.kernels, &first.forward(&x)?)?;
        let x = second.forward_adding(&x, &x)?;
        let x = gelu_exact(self.kernels, &x)?;
        let x = third.forward_adding(&x, &x)?;
        let x = x.reshape((c.frames, rows * columns, c.width))?;
        let places = self.places.unsqueeze(0)?;
        let places = places.broadcast_as((c.frames, rows * columns, 2))?;
        Ok(Seen {
            keys: self.key.forward(&x)?.transpose(1, 2)?.contiguous()?,
            values: Tensor::cat(&[&self.value.forward(&x)?, &places.contiguous()?], 2)?,
        })
    }

    /// Reads an instruction: features (1, L, text features) of its tokens; `mask` (1, L) is 1 for tokens and 0 for padding,
    /// and without it all are read.
    ///
    /// # Errors
    /// If the shapes do not fit.
    pub fn read(&self, features: &Tensor, mask: Option<&Tensor>) -> Result<Asked> {
        let c = &self.config;
        let length = match features.dims() {
            &[1, l, f] if l > 0 && f == c.text_features => l,
            _ => {
                let expected = format!("(1, L, {})", c.text_features);
                return Err(shape_error("the text", expected, features));
            }
        };
        let features = features.to_device(self.tokens.device())?;
        let words = self
            .text
            .forward(&features.to_dtype(self.tokens.dtype())?)?;
        let mut x = Tensor::cat(&[&self.tokens, &words], 1)?;
        let own = c.queries + 1;
        let mask = mask
            .map(|mask| {
                let mask = mask.to_dtype(DType::U32)?;
                let read = Tensor::ones((1, own), DType::U32, mask.device())?;
                additive_mask(&Tensor::cat(&[&read, &mask], 1)?, (1, own + length), &x)
            })
            .transpose()?;
        for block in &self.blocks {
            x = block.forward(&x, mask.as_ref(), None)?;
        }
        let x = x.squeeze(0)?;
        Ok(Asked {
            queries: self.query.forward(&x.narrow(0, 0, c.queries)?)?,
            meaning: x.narrow(0, c.queries, 1)?,
        })
    }

    /// Whether the episode shows what each of the instructions asks for.
    ///
    /// # Errors
    /// If there is no instruction.
    pub fn answer(
        &self,
        seen: &Seen,
        asked: &[Asked],
        dropout: &mut Dropout<'_>,
    ) -> Result<Answers> {
        let c = &self.config;
        let (count, places) = (asked.len(), self.places.dim(0)?);
        let queries: Vec<&Tensor> = asked.iter().map(|asked| &asked.queries).collect();
        let meanings: Vec<&Tensor> = asked.iter().map(|asked| &asked.meaning).collect();
        let queries = Tensor::cat(&queries, 0)?.unsqueeze(0)?;
        let queries = queries.broadcast_as((c.frames, count * c.queries, c.channels))?;
        let scale = 2.0 / (c.channels as f64).sqrt();
        let attention = (queries.contiguous()?.matmul(&seen.keys)? * scale)?;
        let strength = attention.log_sum_exp(D::Minus1)?.unsqueeze(2)?;
        let shares = attention.broadcast_sub(&strength)?.exp()?;
        let found = shares.matmul(&seen.values)?;
        let found = Tensor::cat(&[found, (strength * STRENGTH_SCALE)?], 2)?;
        // (frames, instructions, queries and values) to (instructions, all).
        let found = found.reshape((c.frames, count, ()))?.transpose(0, 1)?;
        let found = found.contiguous()?.flatten_from(1)?;
        let [first, second, third] = &self.head;
        let x = Tensor::cat(&[found, Tensor::cat(&meanings, 0)?], 1)?;
        let x = dropout.apply(&first.forward(&x)?.relu()?)?;
        let x = third.forward(&second.forward(&x)?.relu()?)?;
        let attention = attention.reshape((c.frames, count, c.queries, places))?;
        Ok(Answers {
            logits: x.squeeze(1)?.to_dtype(DType::F32)?,
            attention: attention.to_dtype(DType::F32)?,
        })
    }
}

/// Column and row of each place (places, 2), from -1 to 1.
fn places([rows, columns]: [usize; 2], device: &Device) -> Result<Tensor> {
    let along = |at: usize, count: usize| -1.0 + 2.0 * at as f32 / (count.max(2) - 1) as f32;
    let values = (0..rows).flat_map(|row| {
        (0..columns).flat_map(move |column| [along(column, columns), along(row, rows)])
    });
    let values: Vec<f32> = values.collect();
    Ok(Tensor::from_vec(values, (rows * columns, 2), device)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Supply;

    /// Weights of which no two are alike.
    struct Mixed;

    impl Supply for Mixed {
        fn supply(&self, name: &str, shape: &[usize]) -> Result<Tensor> {
            let count: usize = shape.iter().product();
            let seed: usize = name.bytes().map(usize::from).sum();
            let values = (0..count).map(|i| ((seed + i) * 7919 % 1009) as f32 / 504.0 - 1.0);
            Ok(Tensor::from_iter(values, &Device::Cpu)?.reshape(shape)?)
        }
    }

    fn config() -> GroundedProbeConfig {
        GroundedProbeConfig {
            features: 6,
            grid: [4, 5],
            max_frames: 9,
            text_features: 12,
            frames: 3,
            width: 8,
            channels: 6,
            queries: 2,
            text_width: 16,
            text_depth: 1,
            text_heads: 2,
            hidden: 10,
        }
    }

    #[test]
    fn frames_are_spread_from_the_first_to_the_last() {
        let looked_at = |frames, count| {
            let config = GroundedProbeConfig { frames, ..config() };
            config.looked_at(count)
        };
        assert_eq!(looked_at(3, 9), [0, 4, 8]);
        assert_eq!(looked_at(8, 50), [0, 7, 14, 21, 28, 35, 42, 49]);
        assert_eq!(looked_at(3, 1), [0, 0, 0]);
        assert_eq!(looked_at(1, 5), [0]);
    }

    #[test]
    fn it_answers_each_instruction_as_if_it_were_alone() {
        let loader = Loader::supplied(&Mixed, Kernels::Candle);
        let probe = GroundedProbe::load(&config(), &loader).unwrap();
        let values = (0..7 * 4 * 5 * 6).map(|i| (i as f32 * 0.37).sin());
        let latents = Tensor::from_iter(values, &Device::Cpu).unwrap();
        let latents = latents.reshape((1, 7, 4, 5, 6)).unwrap();
        let text = |length: usize, from: f32| {
            let values = (0..length * 12).map(|i| (from + i as f32 * 0.7).cos());
            let text = Tensor::from_iter(values, &Device::Cpu).unwrap();
            text.reshape((1, length, 12)).unwrap()
        };
        let seen = probe.look(&latents).unwrap();
        let asked = [text(3, 0.0), text(5, 2.0)].map(|text| probe.read(&text, None).unwrap());
        let answer = |asked: &[Asked]| {
            let answers = probe.answer(&seen, asked, &mut Dropout::none()).unwrap();
            assert_eq!(answers.attention.dims(), [3, asked.len(), 2, 20]);
            answers.logits.to_vec1::<f32>().unwrap()
        };
        let together = answer(&asked);
        let alone = asked
            .each_ref()
            .map(|asked| answer(std::slice::from_ref(asked)));
        let alone = alone.concat();
        for (together, alone) in together.iter().zip(&alone) {
            assert!((together - alone).abs() < 1e-5, "{together} {alone}");
        }
        assert!((together[0] - together[1]).abs() > 1e-4, "{together:?}");
        // Padding is not read.
        let padded = Tensor::cat(&[text(3, 0.0), text(2, 9.0)], 1).unwrap();
        let mask = Tensor::new(&[[1u32, 1, 1, 0, 0]], &Device::Cpu).unwrap();
        let padded = answer(&[probe.read(&padded, Some(&mask)).unwrap()]);
        assert!((padded[0] - together[0]).abs() < 1e-5);
    }

    #[test]
    fn other_latents_and_texts_are_refused() {
        let probe = GroundedProbe::load(&config(), &Loader::skeleton(Kernels::Candle)).unwrap();
        let zeros = |shape: &[usize]| Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
        let error = probe
            .look(&zeros(&[1, 2, 4, 4, 6]))
            .unwrap_err()
            .to_string();
        assert!(error.contains("(1, T, 4, 5, 6)"), "{error}");
        let error = probe
            .read(&zeros(&[1, 2, 6]), None)
            .unwrap_err()
            .to_string();
        assert!(error.contains("(1, L, 12)"), "{error}");
    }
}
