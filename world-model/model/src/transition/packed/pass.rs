//! One pass of the network over new frames.

use std::sync::Arc;

use rayon::prelude::*;

use super::frame_context::FrameContext;
use super::head;
use super::kept::{Kept, KeptFormat};
use super::modulation::Modulation;
use super::projection::{Projection, TaskProjection};
use super::tasks::{Tasks, chunk};
use super::{Layers, PackedTransition};
use crate::ops::buffer::Buffer;
use crate::ops::element::Element as _;
use crate::ops::kernel::Product;
use crate::ops::product::{Bf16, F32};
use crate::ops::simd::InstructionSet;
use crate::ops::temporal_attention::{FrameRows, attend_rows, split_rows};
use crate::ops::token_layers::{PackedLayers, Rows};
use crate::ops::{PackedLinear, RotaryTable};
use crate::transition::block::SubBlock;
use crate::{Error, Result};

/// A frame that a pass computes, for a batch of B candidates.
#[derive(Clone, Copy, Debug)]
pub struct NewFrame<'a> {
    /// (B, H, W, C).
    pub latents: &'a [f32],
    /// Noise levels (B), 0..1.
    pub tau: &'a [f32],
    /// What is fed with the frame (B, A).
    pub action: &'a [f32],
}

/// What a pass gives.
#[derive(Debug)]
pub(crate) struct PassOutput {
    /// The first frames' contexts, as many as were asked for.
    pub(crate) contexts: Vec<FrameContext>,
    /// The network's output at the frames that it was asked for, (B, H, W, C) each.
    pub(crate) outputs: Vec<Vec<f32>>,
}

impl PackedTransition {
    /// As [`LoadedTransition::pass`](super::super::LoadedTransition::pass), also beyond the window that the model was
    /// trained for.
    pub(super) fn pass_of_any_length(
        &self,
        earlier: &[&FrameContext],
        frames: &[NewFrame<'_>],
        keep: usize,
        first_output: usize,
    ) -> Result<PassOutput> {
        let modulation = self.modulate_frames(frames)?;
        let latents: Vec<_> = frames
            .iter()
            .enumerate()
            .map(|(i, f)| (f.latents, i))
            .collect();
        self.pass_modulated(earlier, &latents, &modulation, keep, first_output)
    }

    /// As [`Self::pass_of_any_length`], of at least one frame: for the latents of frames and the entries of
    /// `modulation`, this model's, that are theirs. A modulation can serve several passes, the Euler steps of a frame
    /// above all.
    pub(crate) fn pass_modulated(
        &self,
        earlier: &[&FrameContext],
        frames: &[(&[f32], usize)],
        modulation: &Modulation,
        keep: usize,
        first_output: usize,
    ) -> Result<PassOutput> {
        self.check(earlier, frames, modulation)?;
        let wanted = (keep, first_output);
        // One hand-over to the pool, not one at every barrier.
        rayon::scope(|_| match self.layers.format.bf16_unit() {
            Some(unit) => {
                Pass::<Bf16>::new(unit, self, earlier, frames, modulation, wanted).run(frames)
            }
            None => {
                let set = InstructionSet::detect();
                Pass::<F32>::new(set, self, earlier, frames, modulation, wanted).run(frames)
            }
        })
    }

    fn check(
        &self,
        earlier: &[&FrameContext],
        frames: &[(&[f32], usize)],
        modulation: &Modulation,
    ) -> Result<()> {
        let (c, batch) = (&self.config, modulation.batch);
        let latent = c.latent_height * c.latent_width * c.channels;
        let shape = |what, expected, found| {
            Err(Error::Shape {
                what,
                expected,
                found,
            })
        };
        for (latents, entry) in frames {
            if latents.len() != batch * latent || *entry >= modulation.entries {
                let expected = format!(
                    "{} values, and one of {} entries of the modulation",
                    batch * latent,
                    modulation.entries
                );
                return shape("a new frame", expected, vec![latents.len(), *entry]);
            }
        }
        for context in earlier {
            if !Arc::ptr_eq(&context.kept.model, &self.layers)
                || ![1, batch].contains(&context.batch())
            {
                let expected = format!("one of this model, for a batch of 1 or {batch}");
                return shape(
                    "an earlier frame's context",
                    expected,
                    vec![context.batch()],
                );
            }
        }
        Ok(())
    }
}

struct Pass<'a, P: Product> {
    /// What computes the products of the attention within a frame.
    unit: P::Unit,
    model: &'a PackedTransition,
    earlier: &'a [&'a FrameContext],
    tasks: Tasks,
    keep: usize,
    first_output: usize,
    modulation: &'a Modulation,
    /// Of every new frame: its entry of the modulation, and its position in time.
    entries: Vec<usize>,
    angles: Vec<RotaryTable>,
}

impl<'a, P: Product<Scales = ()>> Pass<'a, P>
where
    P::Input: KeptFormat,
{
    fn new(
        unit: P::Unit,
        model: &'a PackedTransition,
        earlier: &'a [&'a FrameContext],
        frames: &[(&[f32], usize)],
        modulation: &'a Modulation,
        (keep, first_output): (usize, usize),
    ) -> Self {
        let c = &model.config;
        let tasks = Tasks {
            blocks: model.layers.blocks,
            batch: modulation.batch,
            times: frames.len(),
            tokens: c.grid().0 * c.grid().1,
        };
        let angles = (0..frames.len())
            .map(|t| RotaryTable::sequence(&[earlier.len() + t], c.head_dim()))
            .collect();
        Self {
            unit,
            model,
            earlier,
            tasks,
            keep: keep.min(frames.len()),
            first_output: first_output.min(frames.len()),
            modulation,
            entries: frames.iter().map(|(_, entry)| *entry).collect(),
            angles,
        }
    }

    fn layers(&self) -> &'a Layers {
        &self.model.layers
    }

    fn run(&self, frames: &[(&[f32], usize)]) -> Result<PassOutput> {
        let (layers, tasks, d) = (self.layers(), &self.tasks, self.model.config.hidden);
        let sub_blocks = self.modulation.sub_blocks.iter();
        let modulations: Vec<Vec<f32>> = sub_blocks
            .map(|values| self.modulation.gathered(values, &self.entries))
            .collect();
        let mut xs = vec![0.0; tasks.count() * tasks.rows() * d];
        let (mut current, mut next) = (Projection::new(tasks), Projection::new(tasks));
        let depth = self.model.config.depth;
        let chunk = (self.keep * tasks.blocks.block() * tasks.blocks.width()).max(1);
        let mut kept = Vec::with_capacity(depth);

        let mut pairs = layers
            .network
            .blocks
            .iter()
            .zip(modulations.chunks_exact(2));
        let mut pair = pairs.next();
        if let Some(([spatial, _], [modulation, _])) = pair {
            xs.par_chunks_mut(tasks.rows() * d)
                .zip(current.parts(tasks))
                .enumerate()
                .try_for_each(|(task, (x, projection))| {
                    let x = self.embed(task, frames, x);
                    self.project(task, spatial, modulation, x, projection)
                })?;
        }
        let mut index = 0;
        while let Some(([spatial, temporal], [by_space, by_time])) = pair {
            pair = pairs.next();
            let layer = Layer {
                index,
                spatial: (spatial, by_space),
                temporal: (temporal, by_time),
            };
            let zeros = || vec![P::Input::ZERO; tasks.count() * chunk];
            let (mut keys, mut values) = (zeros(), zeros());
            xs.par_chunks_mut(tasks.rows() * d)
                .zip(next.parts(tasks))
                .zip(keys.par_chunks_mut(chunk))
                .zip(values.par_chunks_mut(chunk))
                .enumerate()
                .try_for_each(|(task, (((x, projection), keys), values))| {
                    let x = self.used(task, x);
                    let attended = self.attend_in_space(task, &current);
                    let (sub_block, modulation) = layer.spatial;
                    self.finish(sub_block, x, attended, self.modulation(task, modulation, 0))?;
                    self.attend_in_time(task, &layer, x, (keys, values))?;
                    match pair {
                        Some(([spatial, _], [modulation, _])) => {
                            self.project(task, spatial, modulation, x, projection)
                        }
                        _ => Ok(()),
                    }
                })?;
            kept.push((keys, values));
            std::mem::swap(&mut current, &mut next);
            index += 1;
        }
        let outputs = if self.first_output < tasks.times {
            let first = self.first_output;
            let (modulation, entries) = (self.modulation, &self.entries);
            let patches = head::patches(
                &layers.network.head,
                (&xs, d),
                tasks,
                first,
                modulation,
                entries,
            );
            self.assemble(&patches?)
        } else {
            Vec::new()
        };
        let kept = Arc::new(Kept {
            model: self.model.layers.clone(),
            batch: tasks.batch,
            blocks: P::Input::kept(kept),
            chunk,
        });
        let context = |index| FrameContext {
            kept: kept.clone(),
            index,
        };
        Ok(PassOutput {
            contexts: (0..self.keep).map(context).collect(),
            outputs,
        })
    }

    /// The rows of a task's chunk that are in use.
    fn used<'x>(&self, task: usize, x: &'x mut [f32]) -> &'x mut [f32] {
        let rows = self.tasks.times * self.tasks.tokens_of(task);
        x.get_mut(..rows * self.model.config.hidden)
            .unwrap_or_default()
    }

    /// A task's part of a sub-block's modulation, from frame `first` on.
    fn modulation<'m>(&self, task: usize, modulation: &'m [f32], first: usize) -> Rows<'m> {
        let width = modulation.len() / self.tasks.frames().max(1);
        let (from, to) = (
            self.tasks.frame(task, first),
            self.tasks.frame(task, self.tasks.times),
        );
        let frames = modulation.get(from * width..to * width);
        Rows::shared(width, frames.unwrap_or_default())
    }

    /// Writes the tokens `x` after a sub-block to their place, given the result of its attention.
    fn finish(
        &self,
        sub_block: &SubBlock<PackedLinear>,
        x: &mut [f32],
        attended: Buffer,
        modulation: Rows<'_>,
    ) -> Result<()> {
        let d = self.model.config.hidden;
        let (x, attended) = (Rows::in_place(d, x), Rows::own(d, attended));
        let layers = &mut PackedLayers::default();
        sub_block.finish(layers, x, &attended, &modulation)?;
        Ok(())
    }

    /// Patches of a task, as tokens in `x`.
    fn embed<'x>(
        &self,
        task: usize,
        frames: &[(&[f32], usize)],
        x: &'x mut [f32],
    ) -> &'x mut [f32] {
        let c = &self.model.config;
        let latent = c.latent_height * c.latent_width * c.channels;
        let x = self.used(task, x);
        let tokens = self.tasks.tokens_of(task);
        let rows = self.tasks.times * tokens;
        let mut patches = Buffer::of(rows * c.patch_values());
        let blocks = self.tasks.blocks.count();
        let mut targets = patches.chunks_exact_mut(c.patch * c.channels);
        for (latents, _) in frames {
            let latents = chunk(latents, latent, task / blocks);
            for token in 0..tokens {
                let token = task % blocks * self.tasks.blocks.block() + token;
                for run in patch_rows(c, token) {
                    if let (Some(target), Some(source)) = (targets.next(), latents.get(run)) {
                        target.copy_from_slice(source);
                    }
                }
            }
        }
        self.layers().embedding.forward(&patches, x);
        x
    }

    /// Queries, keys and values of a spatial attention, of a task's tokens `x`.
    fn project(
        &self,
        task: usize,
        sub_block: &SubBlock<PackedLinear>,
        modulation: &[f32],
        x: &[f32],
        projection: TaskProjection<'_, P>,
    ) -> Result<()> {
        let (blocks, tokens) = (&self.tasks.blocks, self.tasks.tokens_of(task));
        let (x, modulation) = (
            Rows::shared(blocks.width(), x),
            self.modulation(task, modulation, 0),
        );
        let qkv = sub_block.project(&mut PackedLayers::default(), &x, &modulation)?;
        let size = tokens * blocks.width();
        let queries = projection.queries.chunks_exact_mut(size);
        let keys = projection.keys.chunks_exact_mut(blocks.key_values());
        let values = projection.values.chunks_exact_mut(blocks.value_values());
        let frames = qkv.chunks_exact(3 * size);
        for (qkv, (queries, (keys, values))) in frames.zip(queries.zip(keys.zip(values))) {
            let block = task % blocks.count();
            blocks.pack::<P>(block, qkv, &self.layers().grid, queries, (keys, values));
        }
        Ok(())
    }

    /// Attention within every frame.
    fn attend_in_space(&self, task: usize, projection: &Projection<P>) -> Buffer {
        let (blocks, times) = (&self.tasks.blocks, self.tasks.times);
        let size = self.tasks.tokens_of(task) * blocks.width();
        let queries = projection.queries(&self.tasks, task);
        let mut attended = Buffer::of(times * size);
        let mut scores = Buffer::of(blocks.score_values());
        let first = task / blocks.count() * blocks.count();
        let frames = queries
            .chunks_exact(size)
            .zip(attended.chunks_exact_mut(size));
        for (t, (queries, out)) in frames.enumerate() {
            let packed = |other: usize| projection.packed(&self.tasks, first + other, t);
            blocks.attend::<P>(self.unit, queries, packed, &mut scores, out);
        }
        attended
    }

    /// The temporal sub-block. After the last block only frames that give an output go on.
    fn attend_in_time(
        &self,
        task: usize,
        layer: &Layer<'_>,
        x: &mut [f32],
        (kept_keys, kept_values): (&mut [P::Input], &mut [P::Input]),
    ) -> Result<()> {
        let (d, dim) = (self.model.config.hidden, self.model.config.head_dim());
        let times = self.tasks.times;
        let size = self.tasks.tokens_of(task) * d;
        let first = if layer.index + 1 == self.model.config.depth {
            self.first_output
        } else {
            0
        };
        let (sub_block, modulation) = layer.temporal;
        let of_all = self.modulation(task, modulation, 0);
        let qkv = sub_block.project(&mut PackedLayers::default(), &Rows::shared(d, x), &of_all)?;
        // Keys and values of frames that later frames do not need. No `Buffer`, which has f32 only.
        let dropped = times - self.keep;
        let mut queries = Buffer::of(times * size);
        let zeros = || vec![P::Input::ZERO; dropped * size];
        let (mut keys, mut values) = (zeros(), zeros());
        {
            let parts = queries
                .chunks_exact_mut(size)
                .zip(
                    kept_keys
                        .chunks_exact_mut(size)
                        .take(self.keep)
                        .chain(keys.chunks_exact_mut(size)),
                )
                .zip(
                    kept_values
                        .chunks_exact_mut(size)
                        .take(self.keep)
                        .chain(values.chunks_exact_mut(size)),
                )
                .zip(qkv.chunks_exact(3 * size))
                .zip(&self.angles);
            for ((((queries, keys), values), qkv), angles) in parts {
                split_rows(queries, keys, values, qkv, d, angles);
            }
        }
        let blocks = self.tasks.blocks.count();
        let earlier = self.earlier.iter().map(|context| {
            let shared = context.kept.batch == 1;
            let task = if shared { task % blocks } else { task };
            let rows = context.kept.rows(layer.index, task, context.index, size);
            rows.ok_or_else(|| Error::Shape {
                what: "an earlier frame's context",
                expected: format!("{size} keys and values in the format of the model"),
                found: vec![layer.index, task, context.index],
            })
        });
        let mut frames = earlier.collect::<Result<Vec<FrameRows<'_, P::Input>>>>()?;
        let before = frames.len();
        let own_keys = kept_keys
            .chunks_exact(size)
            .take(self.keep)
            .chain(keys.chunks_exact(size));
        let own_values = kept_values
            .chunks_exact(size)
            .take(self.keep)
            .chain(values.chunks_exact(size));
        frames.extend(own_keys.zip(own_values));
        let mut weights = vec![0.0; frames.len()];
        let mut attended = Buffer::of((times - first) * size);
        let rows = queries.chunks_exact(size).enumerate().skip(first);
        for ((t, queries), out) in rows.zip(attended.chunks_exact_mut(size)) {
            let seen = before + t + 1;
            if let (Some(frames), Some(weights)) = (frames.get(..seen), weights.get_mut(..seen)) {
                attend_rows(out, queries, frames, weights, d, dim);
            }
        }
        let x = x.get_mut(first * size..).unwrap_or_default();
        self.finish(
            sub_block,
            x,
            attended,
            self.modulation(task, modulation, first),
        )
    }

    /// From patches, task by task, to whole frames.
    fn assemble(&self, patches: &[f32]) -> Vec<Vec<f32>> {
        let c = &self.model.config;
        let latent = c.latent_height * c.latent_width * c.channels;
        let frames = self.tasks.times - self.first_output;
        let mut outputs = vec![vec![0.0; self.tasks.batch * latent]; frames];
        let chunk_size = self.tasks.rows() * c.patch_values();
        let blocks = self.tasks.blocks.count();
        for (task, patches) in patches.chunks_exact(chunk_size).enumerate() {
            let tokens = self.tasks.tokens_of(task);
            let mut runs = patches.chunks_exact(c.patch * c.channels);
            let start = task / blocks * latent;
            for output in &mut outputs {
                let Some(output) = output.get_mut(start..start + latent) else {
                    continue;
                };
                for token in 0..tokens {
                    let token = task % blocks * self.tasks.blocks.block() + token;
                    for run in patch_rows(c, token) {
                        if let (Some(target), Some(source)) = (output.get_mut(run), runs.next()) {
                            target.copy_from_slice(source);
                        }
                    }
                }
            }
        }
        outputs
    }
}

/// One block in a pass: its sub-blocks and their modulations.
struct Layer<'a> {
    index: usize,
    spatial: (&'a SubBlock<PackedLinear>, &'a [f32]),
    temporal: (&'a SubBlock<PackedLinear>, &'a [f32]),
}

/// Where the rows of a token's patch lie in a latent.
fn patch_rows(
    c: &crate::transition::TransitionConfig,
    token: usize,
) -> impl Iterator<Item = std::ops::Range<usize>> + use<> {
    let (p, channels, width) = (c.patch, c.channels, c.latent_width);
    let columns = c.grid().1.max(1);
    let (row, column) = (token / columns, token % columns);
    (0..p).map(move |y| {
        let start = ((row * p + y) * width + column * p) * channels;
        start..start + p * channels
    })
}
