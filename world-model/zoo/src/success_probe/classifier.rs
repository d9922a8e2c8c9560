//! From words and latents to a probability.

use candle_core::{DType, Device, Tensor};
use wm_model::autoencoder::Normalisation;

use super::{InstructionTokenizer, SuccessProbe};
use crate::Result;
use crate::vit::SiglipText;

/// The success probe with all that it needs: tokenizer and text tower for the instruction, and the latents' statistics.
///
/// It reads latents as encoder and adapter give them, not normalised: the paper trains it with both frozen (appendix
/// "VLA success classifier probe") and has no statistics of channels; where a model of ours normalises, that is of its
/// transition model. So the normalisation is undone first, as a decoder does.
#[derive(Clone, Debug)]
pub struct SuccessClassifier {
    pub(crate) tokenizer: InstructionTokenizer,
    pub(crate) text: SiglipText,
    pub(crate) probe: SuccessProbe,
    pub(crate) normalisation: Normalisation,
}

/// An instruction as the probe reads it.
#[derive(Clone, Debug)]
pub struct Instruction {
    text: String,
    /// (1, L, text features).
    features: Tensor,
    /// (1, L), 0 for padding.
    mask: Tensor,
}

impl Instruction {
    /// Its words.
    pub fn text(&self) -> &str {
        &self.text
    }
}

impl SuccessClassifier {
    /// Longest episode that is read.
    pub fn max_frames(&self) -> usize {
        self.probe.config().max_frames
    }

    /// Reads an instruction, once for all episodes: this takes the text tower, some fifty billion operations.
    ///
    /// The tower attends to its padding, as it was trained; the probe does not (architecture.md section 7).
    ///
    /// # Errors
    /// As [`InstructionTokenizer::encode`].
    pub fn instruction(&self, text: &str) -> Result<Instruction> {
        let (ids, mask) = self.tokenizer.encode(text)?;
        let ids = Tensor::from_vec(ids, (1, mask.len()), &Device::Cpu)?;
        let mask = Tensor::from_vec(mask, ids.dims(), &Device::Cpu)?;
        Ok(Instruction {
            text: text.to_owned(),
            features: self.text.forward(&ids, None)?,
            mask,
        })
    }

    /// The probability that `episode` shows what the instruction asks for: normalised latents (T, h, w, C), one model
    /// step apart, of which the newest [`max_frames`](Self::max_frames) are read.
    ///
    /// # Errors
    /// If the shape does not fit, or the logit is not finite.
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
        let Instruction { features, mask, .. } = instruction;
        let logit = self.probe.forward(&latents, features, Some(mask))?;
        let logit = logit.squeeze(0)?.to_scalar::<f32>()?;
        if !logit.is_finite() {
            let what = "the success probe's logit";
            return Err(wm_model::Error::NotFinite { what }.into());
        }
        Ok(1.0 / (1.0 + (-logit).exp()))
    }
}
