//! From words and latents to a probability.

use candle_core::{DType, Device, Tensor};
use wm_model::autoencoder::Normalisation;

use super::{InstructionTokenizer, ProbeNetwork, WordEmbedding};
use crate::Result;
use crate::pooled_probe::PooledProbe;
use crate::vit::SiglipText;

/// A success probe with all that it needs: the latents' statistics, and for one that reads an instruction, what reads
/// it.
///
/// One of the paper's reads latents as encoder and adapter give them, not normalised: the paper trains it with both frozen (appendix
/// B.7) and has no statistics of channels; where a model of ours normalises, that is of its transition model. So the
/// normalisation is undone first, as a decoder does. One that `wm train probe` made reads normalised latents.
#[derive(Clone, Debug)]
pub struct SuccessClassifier {
    pub(crate) judge: Judge,
    pub(crate) normalisation: Normalisation,
}

/// What judges an episode.
#[derive(Clone, Debug)]
pub(crate) enum Judge {
    /// By the instruction.
    Instructed(Box<Instructed>),
    /// By the latents alone, whatever the instruction.
    Pooled(PooledProbe),
}

/// A probe, and what reads the instruction for it.
#[derive(Clone, Debug)]
pub(crate) struct Instructed {
    pub(crate) reader: Reader,
    pub(crate) probe: ProbeNetwork,
}

/// What reads instructions.
#[derive(Clone, Debug)]
pub enum Reader {
    /// The paper's: SigLIP 2's text tower with its tokenizer.
    Siglip {
        /// Words to tokens.
        tokenizer: Box<InstructionTokenizer>,
        /// Tokens to features.
        text: Box<SiglipText>,
    },
    /// Words of a closed vocabulary.
    Words(WordEmbedding),
}

/// An instruction as the probe reads it.
#[derive(Clone, Debug)]
pub struct Instruction {
    text: String,
    reading: Option<Reading>,
}

/// What a reader makes of an instruction.
#[derive(Clone, Debug)]
pub struct Reading {
    /// (1, L, text features).
    pub features: Tensor,
    /// (1, L), 0 for padding; `None` where there is no padding.
    pub mask: Option<Tensor>,
}

impl Instruction {
    /// Its words.
    pub fn text(&self) -> &str {
        &self.text
    }
}

impl SuccessClassifier {
    /// What kind of probe it is: transformer, grounded, linear, temporal or progress.
    pub fn kind(&self) -> &'static str {
        match &self.judge {
            Judge::Instructed(judge) => judge.probe.kind(),
            Judge::Pooled(PooledProbe::Linear(_)) => "linear",
            Judge::Pooled(PooledProbe::Temporal(_)) => "temporal",
            Judge::Pooled(PooledProbe::Progress(_)) => "progress",
        }
    }

    /// Whether its answer depends on an instruction.
    pub fn reads_instructions(&self) -> bool {
        matches!(self.judge, Judge::Instructed(_))
    }

    /// Longest episode that is read.
    pub fn max_frames(&self) -> usize {
        match &self.judge {
            Judge::Instructed(judge) => judge.probe.max_frames(),
            Judge::Pooled(probe) => probe.max_frames(),
        }
    }

    /// The words that it knows, of which there is at least one; `None` where it reads any text.
    pub fn vocabulary(&self) -> Option<&[String]> {
        match &self.judge {
            Judge::Instructed(judge) => match &judge.reader {
                Reader::Words(words) => Some(&words.config().vocabulary),
                Reader::Siglip { .. } => None,
            },
            Judge::Pooled(_) => None,
        }
    }

    /// Reads an instruction, once for all episodes: this takes the text tower, some fifty billion operations. A probe of
    /// pooled latents reads none and only keeps its words.
    ///
    /// The tower attends to its padding, as it was trained; the probe does not (the paper, appendix B.7).
    ///
    /// # Errors
    /// As [`InstructionTokenizer::encode`].
    pub fn instruction(&self, text: &str) -> Result<Instruction> {
        let reading = match &self.judge {
            Judge::Instructed(judge) => Some(judge.reader.read(text)?),
            Judge::Pooled(_) => None,
        };
        let text = text.to_owned();
        Ok(Instruction { text, reading })
    }

    /// The probability that `episode` shows what the instruction asks for: normalised latents (T, h, w, C), one model
    /// step apart, of which the newest [`max_frames`](Self::max_frames) are read. Of a progress probe, how far the
    /// newest frame has come.
    ///
    /// # Errors
    /// If the shape does not fit, the instruction was read by another classifier, or the result is not finite.
    pub fn probability(&self, episode: &Tensor, instruction: &Instruction) -> Result<f32> {
        let frames = episode.dim(0)?;
        let read = frames.min(self.max_frames());
        let episode = episode.narrow(0, frames - read, read)?;
        let mut values = episode
            .to_dtype(DType::F32)?
            .flatten_all()?
            .to_vec1::<f32>()?;
        self.normalisation.undo(&mut values);
        let latents = Tensor::from_vec(values, episode.dims(), &Device::Cpu)?.unsqueeze(0)?;
        match (&self.judge, &instruction.reading) {
            (Judge::Pooled(probe), _) => probe.probability(&latents),
            (Judge::Instructed(judge), Some(reading)) => judge.probability(&latents, reading),
            (Judge::Instructed(_), None) => {
                let reason = "read by another classifier, which takes none";
                Err(wm_model::Error::config("instruction", reason.to_owned()).into())
            }
        }
    }
}

impl Reader {
    /// Reads an instruction.
    ///
    /// # Errors
    /// As [`InstructionTokenizer::encode`] and [`WordEmbedding::read`].
    pub fn read(&self, text: &str) -> Result<Reading> {
        match self {
            Self::Siglip {
                tokenizer,
                text: tower,
            } => {
                let (ids, mask) = tokenizer.encode(text)?;
                let ids = Tensor::from_vec(ids, (1, mask.len()), &Device::Cpu)?;
                let mask = Tensor::from_vec(mask, ids.dims(), &Device::Cpu)?;
                let features = tower.forward(&ids, None)?;
                Ok(Reading {
                    features,
                    mask: Some(mask),
                })
            }
            Self::Words(words) => Ok(Reading {
                features: words.read(text)?,
                mask: None,
            }),
        }
    }
}

impl Instructed {
    fn probability(&self, latents: &Tensor, reading: &Reading) -> Result<f32> {
        let logit = self.probe.forward(latents, Some(reading))?;
        let logit = logit.squeeze(0)?.to_scalar::<f32>()?;
        if !logit.is_finite() {
            let what = "the success probe's logit";
            return Err(wm_model::Error::NotFinite { what }.into());
        }
        Ok(1.0 / (1.0 + (-logit).exp()))
    }
}
