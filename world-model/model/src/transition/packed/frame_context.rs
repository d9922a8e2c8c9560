//! What a frame contributes to later ones.

use std::sync::Arc;

use super::Layers;
use super::tasks::Tasks;
use crate::ops::temporal_attention::FrameRows;

/// One frame as the temporal attention of later frames sees it: its keys and values in every block.
#[derive(Clone, Debug)]
pub(crate) struct FrameContext {
    pub(super) kept: Arc<Kept>,
    /// Which of the frames that were computed together.
    pub(super) index: usize,
}

impl FrameContext {
    /// Number of candidates that it was computed for.
    pub(crate) fn batch(&self) -> usize {
        self.kept.batch
    }
}

/// Keys and values of frames that were computed together.
#[derive(Debug)]
pub(super) struct Kept {
    /// The model that computed them.
    pub(super) model: Arc<Layers>,
    pub(super) batch: usize,
    /// Block by block: keys and values, task by task (frames, tokens, d), in chunks of
    /// `chunk` values.
    pub(super) layers: Vec<(Vec<f32>, Vec<f32>)>,
    pub(super) chunk: usize,
}

impl Kept {
    pub(super) fn new(model: Arc<Layers>, depth: usize, tasks: &Tasks, frames: usize) -> Self {
        let chunk = (frames * tasks.blocks.block() * tasks.blocks.width()).max(1);
        let zeros = || vec![0.0; tasks.count() * chunk];
        Self {
            model,
            batch: tasks.batch,
            layers: (0..depth).map(|_| (zeros(), zeros())).collect(),
            chunk,
        }
    }

    /// Frame `index` of a task in one block, `size` values.
    pub(super) fn rows(
        &self,
        layer: usize,
        task: usize,
        index: usize,
        size: usize,
    ) -> Option<FrameRows<'_>> {
        let (keys, values) = self.layers.get(layer)?;
        let start = task * self.chunk + index * size;
        Some((
            keys.get(start..start + size)?,
            values.get(start..start + size)?,
        ))
    }
}
