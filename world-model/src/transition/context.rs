//! Clean frames as the temporal attention of later frames sees them.
//!
//! Temporal attention is causal, so what a clean frame contributes to later ones, its keys and
//! values in every block, does not depend on them: it is computed once and used in every
//! integration step of every later frame, and shared by all candidates of a plan.

use candle_core::Tensor;

use super::Transition;
use super::embedding::Patches;
use crate::ops::{FrameKeys, RotaryTable};
use crate::{Error, Result};

/// Keys and values of one frame in every block.
#[derive(Clone, Debug)]
pub struct FrameContext(Vec<FrameKeys>);

impl FrameContext {
    /// Number of candidates that it was computed for.
    pub fn batch(&self) -> usize {
        self.0.first().map_or(1, FrameKeys::batch)
    }
}

impl Transition {
    /// The network's output at one new frame, and the frame's own keys and values.
    ///
    /// `x` is (B, 1, H, W, C), `tau` (B, 1), `action` (B, 1, A); `earlier` are the frames at
    /// positions 0, 1, .., each computed for a batch of B, or of 1, which is then shared. Equal to
    /// the last frame of [`Transition::output`] over the whole window.
    ///
    /// # Errors
    /// If the shapes do not fit, or the window is full.
    pub fn output_after(
        &self,
        earlier: &[&FrameContext],
        x: &Tensor,
        tau: &Tensor,
        action: &Tensor,
    ) -> Result<(Tensor, FrameContext)> {
        let (b, t) = self.check_input(x, tau, action)?;
        let position = earlier.len();
        if t != 1 || position >= self.config.max_frames {
            return Err(Error::Shape {
                what: "the new frame",
                expected: format!(
                    "(B, 1, H, W, C) after at most {} frames, of which {position} are there",
                    self.config.max_frames - 1
                ),
                found: x.dims().to_vec(),
            });
        }
        let angles = RotaryTable::sequence(&[position], self.config.head_dim());
        let mut tokens = self.embedding.tokens(&Patches::of(x, self.config.patch)?)?;
        let condition = self
            .embedding
            .condition(&tau.flatten_all()?, &action.flatten_to(1)?)?;
        let mut own = Vec::with_capacity(self.blocks.len());
        for (i, block) in self.blocks.iter().enumerate() {
            let keys: Vec<&FrameKeys> = earlier.iter().filter_map(|f| f.0.get(i)).collect();
            if keys.len() != position {
                return Err(Error::config(
                    "depth",
                    "an earlier frame was computed by another model",
                ));
            }
            let (next, keys) =
                block.forward_after(&tokens, &condition, &self.spatial, &keys, &angles)?;
            tokens = next;
            own.push(keys);
        }
        let out = self.head.forward(&tokens, &condition)?;
        let out = Patches::into_grid(&out, (b, 1), &self.config)?;
        Ok((out, FrameContext(own)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transition::{TemporalPattern, TransitionConfig};
    use candle_core::Device;

    #[test]
    fn frame_by_frame_equals_all_at_once() {
        let config = TransitionConfig::preset("tiny", (8, 8, 4), 2, 7).unwrap();
        let model = Transition::random(config, 3).unwrap();
        let (b, t) = (2, 5);
        let x = Tensor::randn(0f32, 1.0, (b, t, 8, 8, 4), &Device::Cpu).unwrap();
        let tau = Tensor::rand(0f32, 1.0, (b, t), &Device::Cpu).unwrap();
        let action = Tensor::randn(0f32, 1.0, (b, t, 7), &Device::Cpu).unwrap();
        let whole = model
            .output(&x, &tau, &action, &TemporalPattern::causal(t))
            .unwrap();
        let mut frames: Vec<FrameContext> = Vec::new();
        for i in 0..t {
            let part = |x: &Tensor| x.narrow(1, i, 1).unwrap();
            let earlier: Vec<_> = frames.iter().collect();
            let (out, own) = model
                .output_after(&earlier, &part(&x), &part(&tau), &part(&action))
                .unwrap();
            let difference = (out - part(&whole)).unwrap().abs().unwrap();
            let most = difference.max_all().unwrap().to_scalar::<f32>().unwrap();
            assert!(most < 1e-5, "frame {i} differs by {most}");
            frames.push(own);
        }
    }
}
