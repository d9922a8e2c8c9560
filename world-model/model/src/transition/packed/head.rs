//! From the tokens of all tasks back to patches.

use rayon::prelude::*;

use super::modulation::Modulation;
use super::tasks::Tasks;
use crate::ops::PackedLinear;
use crate::ops::buffer::Buffer;
use crate::ops::token_layers::{PackedLayers, Rows};
use crate::transition::head::Head;
use crate::{Error, Result};

/// Patches of the frames from `first` on, task by task (frames, tokens, p * p * C), each in a chunk of `tasks.rows()`
/// rows, of the tokens `xs` (width d) of all frames.
pub(super) fn patches(
    head: &Head<PackedLinear>,
    (xs, d): (&[f32], usize),
    tasks: &Tasks,
    first: usize,
    modulation: &Modulation,
    entries: &[usize],
) -> Result<Vec<f32>> {
    let values = head.linear.outputs();
    let Some(wide) = &head.wide else {
        let plain = modulation.head.as_deref().unwrap_or_default();
        let plain = modulation.gathered(plain, entries);
        return of_tasks((xs, d), &plain, tasks, (first, 0), values, |x, rows| {
            head.patches(&mut PackedLayers::default(), &x, &rows)
        });
    };
    let time = modulation.gathered(&modulation.time, entries);
    let width = wide.outputs();
    let xs = of_tasks((xs, d), &time, tasks, (first, first), width, |x, rows| {
        Head::widened(&mut PackedLayers::default(), wide, &x, &rows)
    })?;
    let means = Rows::own(width, frame_means(&xs, tasks, first, width));
    let rows = head.wide_modulation(&mut PackedLayers::default(), means)?;
    of_tasks((&xs, width), &rows, tasks, (first, 0), values, |x, rows| {
        head.patches(&mut PackedLayers::default(), &x, &rows)
    })
}

/// What `compute` makes of every task's tokens of the frames from `first` on (frames, tokens, width), and of the rows of
/// these frames: (frames, tokens, outputs), task by task, each in a chunk of `tasks.rows()` rows after zeros for
/// `skipped` frames.
fn of_tasks(
    (xs, width): (&[f32], usize),
    rows: &[f32],
    tasks: &Tasks,
    (first, skipped): (usize, usize),
    outputs: usize,
    compute: impl for<'a> Fn(Rows<'a>, Rows<'a>) -> Result<Rows<'a>> + Sync,
) -> Result<Vec<f32>> {
    let row = rows.len() / tasks.frames().max(1);
    let mut out = vec![0.0; tasks.count() * tasks.rows() * outputs];
    out.par_chunks_mut(tasks.rows() * outputs)
        .zip(xs.par_chunks(tasks.rows() * width))
        .enumerate()
        .try_for_each(|(task, (out, xs))| {
            let tokens = tasks.tokens_of(task);
            let xs = xs.get(first * tokens * width..tasks.times * tokens * width);
            let frames = tasks.frame(task, first) * row..tasks.frame(task, tasks.times) * row;
            let (xs, rows) = (xs.unwrap_or_default(), rows.get(frames).unwrap_or_default());
            let made = compute(Rows::shared(width, xs), Rows::shared(row, rows))?;
            let out = out
                .get_mut(skipped * tokens * outputs..)
                .unwrap_or_default();
            for (out, made) in out.iter_mut().zip(made.iter()) {
                *out = *made;
            }
            Ok::<(), Error>(())
        })?;
    Ok(out)
}

/// The mean of every frame's tokens (frames, width), from frame `first` of a task on.
fn frame_means(xs: &[f32], tasks: &Tasks, first: usize, width: usize) -> Buffer {
    let mut means = Buffer::zeros(tasks.frames() * width);
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
    for mean in means.iter_mut() {
        *mean /= tasks.tokens as f32;
    }
    means
}
