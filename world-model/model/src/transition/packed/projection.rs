//! Queries, keys and values between two barriers.

use rayon::prelude::*;

use super::tasks::{Tasks, chunk};
use crate::ops::block_attention::Packed;
use crate::ops::element::Element;
use crate::ops::kernel::Product;

/// Queries, keys and values of a spatial attention, of all tasks.
pub(super) struct Projection<P: Product> {
    queries: Vec<P::Input>,
    keys: Vec<P::Weight>,
    values: Vec<P::Weight>,
}

/// One task's part of a [`Projection`].
pub(super) struct TaskProjection<'a, P: Product> {
    pub(super) queries: &'a mut [P::Input],
    pub(super) keys: &'a mut [P::Weight],
    pub(super) values: &'a mut [P::Weight],
}

impl<P: Product> Projection<P> {
    pub(super) fn new(tasks: &Tasks) -> Self {
        let frames = tasks.count() * tasks.times;
        let blocks = &tasks.blocks;
        Self {
            queries: vec![P::Input::ZERO; frames * blocks.block() * blocks.width()],
            keys: vec![P::Weight::ZERO; frames * blocks.key_values()],
            values: vec![P::Weight::ZERO; frames * blocks.value_values()],
        }
    }

    /// The tasks' parts, to be written.
    pub(super) fn parts(
        &mut self,
        tasks: &Tasks,
    ) -> impl IndexedParallelIterator<Item = TaskProjection<'_, P>> {
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
    pub(super) fn queries(&self, tasks: &Tasks, task: usize) -> &[P::Input] {
        chunk(
            &self.queries,
            self.queries.len() / tasks.count().max(1),
            task,
        )
    }

    /// A task's packed keys and values of its t-th frame.
    pub(super) fn packed(&self, tasks: &Tasks, task: usize, t: usize) -> Packed<'_, P::Weight> {
        let (blocks, frame) = (&tasks.blocks, task * tasks.times + t);
        (
            chunk(&self.keys, blocks.key_values(), frame),
            chunk(&self.values, blocks.value_values(), frame),
        )
    }
}
