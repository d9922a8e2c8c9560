//! From tokens back to patches.

use rayon::prelude::*;

use super::condition::product;
use super::modulation::Modulation;
use super::source::NamedLayers;
use super::sub_block::part;
use super::tasks::Tasks;
use crate::Result;
use crate::ops::activation::silu_chunk as silu;
use crate::ops::{PackedLinear, rms_norm_modulate};
use crate::transition::head;

/// The last layers.
#[derive(Debug)]
pub(super) struct Head {
    /// The wide head's projection; the plain head has none.
    wide: Option<PackedLinear>,
    modulation: PackedLinear,
    linear: PackedLinear,
}

impl Head {
    pub(super) fn new(layers: &NamedLayers<'_>) -> Result<Self> {
        let name = head::name(layers.config());
        let wide = layers.config().wide_head;
        Ok(Self {
            wide: wide.map(|_| layers.linear(head::WIDE)).transpose()?,
            modulation: layers.sensitive(&format!("{name}.adaLN_modulation.1"))?,
            linear: layers.sensitive(&format!("{name}.linear"))?,
        })
    }

    /// What makes the plain head's modulation, which depends on noise level and action only.
    pub(super) fn plain_modulation(&self) -> Option<&PackedLinear> {
        self.wide.is_none().then_some(&self.modulation)
    }

    /// Patches of the frames from `first` on, task by task (frames, tokens, p * p * C), each in a
    /// chunk of `tasks.rows()` rows, of the tokens `xs` of all frames.
    pub(super) fn forward(
        &self,
        xs: &[f32],
        tasks: &Tasks,
        first: usize,
        modulation: &Modulation,
        entries: &[usize],
    ) -> Vec<f32> {
        match &self.wide {
            None => {
                let plain = modulation.head.as_deref().unwrap_or_default();
                self.patches(xs, tasks, first, &modulation.gathered(plain, entries))
            }
            Some(wide) => {
                // The wide head is conditioned on the noise level here, and from then on only on
                // what it made of the frame.
                let time = modulation.gathered(&modulation.time, entries);
                let xs = widen(wide, xs, tasks, first, &time);
                let mut means = frame_means(&xs, tasks, first, wide.outputs());
                silu(&mut means);
                let modulation = product(&self.modulation, &means, tasks.frames());
                self.patches(&xs, tasks, first, &modulation)
            }
        }
    }

    fn patches(&self, xs: &[f32], tasks: &Tasks, first: usize, modulation: &[f32]) -> Vec<f32> {
        let (width, values) = (self.linear.inputs(), self.linear.outputs());
        let mut out = vec![0.0; tasks.count() * tasks.rows() * values];
        out.par_chunks_mut(tasks.rows() * values)
            .zip(xs.par_chunks(tasks.rows() * width))
            .enumerate()
            .for_each_init(Vec::new, |normed: &mut Vec<f32>, (task, (out, xs))| {
                let tokens = tasks.tokens_of(task);
                let frames = xs.chunks_exact(tokens * width).take(tasks.times);
                let outs = out.chunks_exact_mut(tokens * values);
                for ((t, x), out) in frames.enumerate().skip(first).zip(outs) {
                    normed.resize(x.len(), 0.0);
                    let modulation = part(modulation, 2 * width, tasks.frame(task, t));
                    let modulation = modulation.unwrap_or_default();
                    if let (Some(shift), Some(scale)) =
                        (part(modulation, width, 0), part(modulation, width, 1))
                    {
                        rms_norm_modulate::forward_frame(normed, x, shift, scale);
                    }
                    self.linear.forward(normed, out);
                }
            });
        out
    }
}

/// The projection of silu(tokens + time embedding) of the frames from `first` on, laid out as `xs`.
fn widen(wide: &PackedLinear, xs: &[f32], tasks: &Tasks, first: usize, time: &[f32]) -> Vec<f32> {
    let (d, width) = (wide.inputs(), wide.outputs());
    let mut out = vec![0.0; tasks.count() * tasks.rows() * width];
    out.par_chunks_mut(tasks.rows() * width)
        .zip(xs.par_chunks(tasks.rows() * d))
        .enumerate()
        .for_each(|(task, (out, xs))| {
            let tokens = tasks.tokens_of(task);
            let frames = xs.chunks_exact(tokens * d).take(tasks.times);
            let outs = out.chunks_exact_mut(tokens * width);
            for (t, (x, out)) in frames.zip(outs).enumerate().skip(first) {
                let time = part(time, d, tasks.frame(task, t)).unwrap_or_default();
                let mut timed = x.to_vec();
                for row in timed.chunks_exact_mut(d) {
                    for (x, time) in row.iter_mut().zip(time) {
                        *x += time;
                    }
                }
                silu(&mut timed);
                wide.forward(&timed, out);
            }
        });
    out
}

/// The mean of every frame's tokens (frames, width), from frame `first` of a task on.
fn frame_means(xs: &[f32], tasks: &Tasks, first: usize, width: usize) -> Vec<f32> {
    let mut means = vec![0.0; tasks.frames() * width];
    for (task, xs) in xs.chunks_exact(tasks.rows() * width).enumerate() {
        let tokens = tasks.tokens_of(task);
        let frames = xs.chunks_exact(tokens * width).take(tasks.times);
        for (t, x) in frames.enumerate().skip(first) {
            let frame = tasks.frame(task, t);
            let mean = means.get_mut(frame * width..(frame + 1) * width);
            let mean = mean.unwrap_or_default();
            for row in x.chunks_exact(width) {
                for (mean, x) in mean.iter_mut().zip(row) {
                    *mean += x;
                }
            }
        }
    }
    for mean in &mut means {
        *mean /= tasks.tokens as f32;
    }
    means
}
