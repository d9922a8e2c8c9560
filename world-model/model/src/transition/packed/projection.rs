//! Queries, keys and values between two barriers.

use rayon::prelude::*;

use super::tasks::{Tasks, chunk};
use crate::ops::block_attention::Packed;

/// Queries, keys and values of a spatial attention, of all tasks.
pub(super) struct Projection {
    queries: Vec<f32>,
    keys: Vec<f32>,
    values: Vec<f32>,
}

/// One task's part of a [`Projection`].
pub(super) struct TaskProjection<'a> {
    pub(super) queries: &'a mut [f32],
    pub(super) keys: &'a mut [f32],
    pub(super) values: &'a mut [f32],
}

impl Projection {
    pub(super) fn new(tasks: &Tasks) -> Self {
        let frames = tasks.count() * tasks.times;
        let blocks = &tasks.blocks;
        Self {
            queries: vec![0.0; frames * blocks.block() * blocks.width()],
            keys: vec![0.0; frames * blocks.key_values()],
            values: vec![0.0; frames * blocks.value_values()],
        }
    }

    /// The tasks' parts, to be written.
    pub(super) fn parts(
        &mut self,
        tasks: &Tasks,
    ) -> impl IndexedParallelIterator<Item = TaskProjection<'_>> {
        let n = tasks.count().max(1);
        let (queries, keys, values) = (
            self.queries.len() / n,
            self.keys.len() / n,
            self.values.len() / n,
        );
        self.queries
            .par_chunks_mut(queries)
            .zip(self.keys.par_chunks_mut(keys))
            .zip(self.values.par_chunks_mut(values))
            .map(|((queries, keys), values)| TaskProjection {
                queries,
                keys,
                values,
            })
    }

    /// A task's queries (frames, tokens, d).
    pub(super) fn queries(&self, tasks: &Tasks, task: usize) -> &[f32] {
        chunk(
            &self.queries,
            self.queries.len() / tasks.count().max(1),
            task,
        )
    }

    /// A task's packed keys and values of its t-th frame.
    pub(super) fn packed(&self, tasks: &Tasks, task: usize, t: usize) -> Packed<'_> {
        let (blocks, frame) = (&tasks.blocks, task * tasks.times + t);
        (
            chunk(&self.keys, blocks.key_values(), frame),
            chunk(&self.values, blocks.value_values(), frame),
        )
    }
}
