//! How the work of a pass is shared out.

use crate::ops::block_attention::TokenBlocks;

/// How a pass is cut into tasks: number b * blocks + i is block i of candidate b, in all new
/// frames. Buffers are task by task, frame by frame, token by token.
pub(super) struct Tasks {
    pub(super) blocks: TokenBlocks,
    /// Candidates.
    pub(super) batch: usize,
    /// New frames of a candidate.
    pub(super) times: usize,
    /// Tokens of a frame.
    pub(super) tokens: usize,
}

impl Tasks {
    pub(super) fn count(&self) -> usize {
        self.batch * self.blocks.count()
    }

    /// New frames of all candidates; the t-th of candidate b is number b * times + t.
    pub(super) fn frames(&self) -> usize {
        self.batch * self.times
    }

    /// The number of a task's t-th frame.
    pub(super) fn frame(&self, task: usize, t: usize) -> usize {
        task / self.blocks.count() * self.times + t
    }

    /// Tokens of a task's block.
    pub(super) fn tokens_of(&self, task: usize) -> usize {
        self.blocks.tokens_of(task % self.blocks.count())
    }

    /// Rows that a task's chunk of a buffer has place for.
    pub(super) fn rows(&self) -> usize {
        self.times * self.blocks.block()
    }
}

/// Chunk `i` of those of `size`.
pub(super) fn chunk<T>(values: &[T], size: usize, i: usize) -> &[T] {
    values.get(i * size..(i + 1) * size).unwrap_or_default()
}
