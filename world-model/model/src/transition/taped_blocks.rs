//! All blocks as one operation of candle's, for training on the CPU.
//!
//! The operation records a [`TokenTape`] and runs it backward. An operation of candle's has three operands at most, so
//! that gradients by weights go another way: [`WeightGradients`].

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use candle_core::{CpuStorage, CustomOp2, Error, Layout, Result, Shape, Tensor};

use super::block::{Block, run_clips};
use crate::ops::AttentionPattern;
use crate::ops::buffer::Buffer;
use crate::ops::host::{host, slice};
use crate::ops::token_layers::{Linear, Sizes, TokenTape, WeightGradients};

/// As [`run_clips`], for `tokens` (B, T, N, d) and `activated` (B T, d).
///
/// # Errors
/// If the shapes do not fit.
pub(super) fn taped_blocks(
    blocks: &[Block<Linear>],
    (tokens, activated): (&Tensor, &Tensor),
    patterns: [&Arc<AttentionPattern>; 2],
    last: usize,
    gradients: &WeightGradients,
) -> Result<Tensor> {
    let op = TapedBlocks {
        blocks: blocks.to_vec(),
        patterns: patterns.map(Arc::clone),
        last,
        record: Mutex::default(),
        gradients: gradients.clone(),
    };
    tokens.contiguous()?.apply_op2(&activated.contiguous()?, op)
}

struct TapedBlocks {
    blocks: Vec<Block<Linear>>,
    patterns: [Arc<AttentionPattern>; 2],
    last: usize,
    record: Mutex<Record>,
    gradients: WeightGradients,
}

/// The forward pass, and its values there.
#[derive(Default)]
struct Record {
    tape: TokenTape,
    inputs: [usize; 2],
    output: usize,
}

impl TapedBlocks {
    fn record(&self) -> MutexGuard<'_, Record> {
        self.record.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl CustomOp2 for TapedBlocks {
    fn name(&self) -> &'static str {
        "transition blocks"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (clips, frames, rows, width) = l1.shape().dims4()?;
        if l2.shape().dims2()? != (clips * frames, width) || !(1..=frames).contains(&self.last) {
            let (tokens, activated) = (l1.shape(), l2.shape());
            candle_core::bail!(
                "blocks: the last {} of {tokens:?}, {activated:?}",
                self.last
            );
        }
        let tokens = Sizes {
            clips,
            frames,
            rows,
            width,
        };
        let activated = Sizes { rows: 1, ..tokens };
        let mut record = self.record();
        let Record {
            tape,
            inputs,
            output,
        } = &mut *record;
        tape.clear();
        *inputs = [
            tape.input(slice(s1, l1)?, tokens),
            tape.input(slice(s2, l2)?, activated),
        ];
        let (patterns, [tokens, activated]) = (self.patterns.each_ref(), *inputs);
        let after = run_clips(&self.blocks, tape, tokens, &activated, patterns, self.last);
        *output = after.map_err(Error::wrap)?;
        let numbers = tape.numbers(*output).to_vec();
        let shape = (clips, self.last, rows, width);
        Ok((CpuStorage::F32(numbers), shape.into()))
    }

    fn bwd(
        &self,
        tokens: &Tensor,
        activated: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let grad = grad.contiguous()?;
        let g = Buffer::copy_of(host(&grad).values()?);
        let record = self.record();
        let (tape, inputs, output) = (&record.tape, record.inputs, record.output);
        let by_inputs = tape.backward(output, g, &self.gradients, inputs);
        let [by_tokens, by_activated] = by_inputs.map_err(Error::wrap)?;
        let by_tokens = Tensor::from_slice(&by_tokens, tokens.shape(), tokens.device())?;
        let by_activated =
            Tensor::from_slice(&by_activated, activated.shape(), activated.device())?;
        Ok((Some(by_tokens), Some(by_activated)))
    }
}
