//! Keys and values that later frames attend to.

use std::sync::Arc;

use half::bf16;

use super::Layers;
use crate::ops::element::Float;
use crate::ops::temporal_attention::FrameRows;

/// Keys and values of frames that were computed together.
#[derive(Debug)]
pub(super) struct Kept {
    /// The model that computed them.
    pub(super) model: Arc<Layers>,
    pub(super) batch: usize,
    pub(super) blocks: KeptBlocks,
    /// Values of a task, in each block.
    pub(super) chunk: usize,
}

impl Kept {
    /// Frame `index` of a task in one block, `size` values; `None` if they are in another format.
    pub(super) fn rows<T: KeptFormat>(
        &self,
        block: usize,
        task: usize,
        index: usize,
        size: usize,
    ) -> Option<FrameRows<'_, T>> {
        let (keys, values) = T::of(&self.blocks)?.get(block)?;
        let start = task * self.chunk + index * size;
        Some((
            keys.get(start..start + size)?,
            values.get(start..start + size)?,
        ))
    }
}

/// Keys and values of a block, task by task (frames, tokens, d).
pub(super) type KeysValues<T> = (Vec<T>, Vec<T>);

/// Keys and values of every block, in the number format of the model's attention.
#[derive(Debug)]
pub(super) enum KeptBlocks {
    F32(Vec<KeysValues<f32>>),
    Bf16(Vec<KeysValues<bf16>>),
}

/// A number format of keys and values.
pub(super) trait KeptFormat: Float {
    fn kept(blocks: Vec<KeysValues<Self>>) -> KeptBlocks;

    /// `None` if `blocks` are in another format.
    fn of(blocks: &KeptBlocks) -> Option<&[KeysValues<Self>]>;
}

impl KeptFormat for f32 {
    fn kept(blocks: Vec<KeysValues<f32>>) -> KeptBlocks {
        KeptBlocks::F32(blocks)
    }

    fn of(blocks: &KeptBlocks) -> Option<&[KeysValues<f32>]> {
        match blocks {
            KeptBlocks::F32(blocks) => Some(blocks),
            KeptBlocks::Bf16(_) => None,
        }
    }
}

impl KeptFormat for bf16 {
    fn kept(blocks: Vec<KeysValues<bf16>>) -> KeptBlocks {
        KeptBlocks::Bf16(blocks)
    }

    fn of(blocks: &KeptBlocks) -> Option<&[KeysValues<bf16>]> {
        match blocks {
            KeptBlocks::Bf16(blocks) => Some(blocks),
            KeptBlocks::F32(_) => None,
        }
    }
}
