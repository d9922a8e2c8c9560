//! Gradients of a convolution.

use std::cell::RefCell;

use rayon::prelude::*;

use super::band::Band;
use super::sweep::{Output, Sweep};
use super::{ConvShape, GridSize, check_length};
use crate::Result;
use crate::ops::kernel::Outer;
use crate::ops::panels::Panels;
use crate::ops::simd::LANES;

/// Parts into which the sum over images is split. It is fixed, and the parts are added in order,
/// so that the sum does not depend on the number of threads.
const PARTS: usize = 8;

/// Pixels that a tile of the weight gradient sums over before it goes back to memory.
const PIXELS_A_PASS: usize = 64;

/// Gradient by the input of [`super::PackedConv::run`], given the `gradient` by its output.
///
/// `grid` is the size of the convolution's input. `residual` (of the input's shape) is added, and
/// where `mask` (the same shape) is not positive the result becomes zero: with the convolution's
/// input as mask that is the gradient through the ReLU that made the input.
///
/// # Errors
/// If the shape is invalid or a slice has the wrong length for it.
pub fn conv2d_input_gradient(
    shape: &ConvShape,
    weight: &[f32],
    gradient: &[f32],
    grid: GridSize,
    residual: Option<&[f32]>,
    mask: Option<&[f32]>,
    output: &mut Vec<f32>,
) -> Result<()> {
    shape.check()?;
    let target = shape.output(grid);
    let length = grid.pixels() * shape.inputs;
    check_length("convolution weights", weight, shape.weights())?;
    check_length(
        "convolution output gradient",
        gradient,
        target.pixels() * shape.outputs,
    )?;
    for slice in [residual, mask].into_iter().flatten() {
        check_length("convolution residual or mask", slice, length)?;
    }
    output.resize(length, 0.0);
    if shape.upsample {
        let mut doubled = vec![0.0; target.pixels() * shape.inputs];
        let plain = ConvShape {
            upsample: false,
            ..*shape
        };
        sweep_back(&plain, weight, gradient, target, None, None, &mut doubled);
        pool(&doubled, target, shape.inputs, residual, mask, output);
    } else {
        sweep_back(shape, weight, gradient, grid, residual, mask, output);
    }
    Ok(())
}

/// Writes the input gradient of a convolution without upsampling.
fn sweep_back(
    shape: &ConvShape,
    weight: &[f32],
    gradient: &[f32],
    grid: GridSize,
    residual: Option<&[f32]>,
    mask: Option<&[f32]>,
    output: &mut [f32],
) {
    let ConvShape {
        inputs,
        outputs,
        kernel,
        stride,
        ..
    } = *shape;
    for row in 0..stride.min(grid.height) {
        for column in 0..stride.min(grid.width) {
            // Input rows of this parity get a share from the taps of one parity only.
            let (rows, row_pad) = taps(kernel, stride, row);
            let (columns, column_pad) = taps(kernel, stride, column);
            let depth = rows.len() * columns.len() * outputs;
            let panels = Panels::pack(depth, inputs, None, |k, channel| {
                let (tap, from) = (k / outputs, k % outputs);
                let tap_row = rows.get(tap / columns.len()).copied().unwrap_or_default();
                let tap_column = columns
                    .get(tap % columns.len())
                    .copied()
                    .unwrap_or_default();
                let at = ((tap_row * kernel + tap_column) * inputs + channel) * outputs + from;
                weight.get(at).copied().unwrap_or_default()
            });
            Sweep {
                input: gradient,
                grid: shape.output(grid),
                channels: outputs,
                taps: (rows.len(), columns.len()),
                stride: 1,
                pad: (row_pad, column_pad),
                panels: &panels,
                residual,
                mask,
                relu: false,
            }
            .run(
                Output {
                    height: (grid.height - row).div_ceil(stride),
                    width: (grid.width - column).div_ceil(stride),
                    start: (row * grid.width + column) * inputs,
                    pixel_step: stride * inputs,
                    row_step: stride * grid.width * inputs,
                    image_step: grid.height * grid.width * inputs,
                },
                output,
            );
        }
    }
}

/// Taps that reach input rows of parity `phase`, in the order of the output rows that they reach
/// them from, and how many rows before its own place the first of those lies.
fn taps(kernel: usize, stride: usize, phase: usize) -> (Vec<usize>, isize) {
    let reach = phase + kernel / 2;
    let taps: Vec<usize> = (0..kernel)
        .rev()
        .filter(|tap| (reach + kernel * stride - tap).is_multiple_of(stride))
        .collect();
    let first = taps.first().copied().unwrap_or_default();
    let pad = -((reach as isize - first as isize).div_euclid(stride as isize));
    (taps, pad)
}

/// Sums each 2x2 square of `doubled` (the backward of nearest-neighbour doubling).
fn pool(
    doubled: &[f32],
    grid: GridSize,
    channels: usize,
    residual: Option<&[f32]>,
    mask: Option<&[f32]>,
    output: &mut [f32],
) {
    let pitch = grid.width * channels;
    let row = pitch / 2;
    output
        .par_chunks_exact_mut(row)
        .zip(doubled.par_chunks_exact(2 * pitch))
        .enumerate()
        .for_each(|(y, (target, source))| {
            let (upper, lower) = source.split_at(pitch);
            let squares = upper
                .chunks_exact(2 * channels)
                .zip(lower.chunks_exact(2 * channels));
            for (pixel, (upper, lower)) in target.chunks_exact_mut(channels).zip(squares) {
                let (a, b) = upper.split_at(channels);
                let (c, d) = lower.split_at(channels);
                for ((((v, a), b), c), d) in pixel.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                    *v = (a + b) + (c + d);
                }
            }
            let same = |slice: Option<&'_ [f32]>| -> Option<Vec<f32>> {
                slice?.get(y * row..(y + 1) * row).map(<[f32]>::to_vec)
            };
            if let Some(residual) = same(residual) {
                for (v, r) in target.iter_mut().zip(residual) {
                    *v += r;
                }
            }
            if let Some(mask) = same(mask) {
                for (v, m) in target.iter_mut().zip(mask) {
                    *v = if m > 0.0 { *v } else { 0.0 };
                }
            }
        });
}

/// Gradients by the weights and the bias of [`super::PackedConv::run`], given the `gradient` by its output
/// (after the ReLU, if there was one); both are overwritten.
///
/// # Errors
/// If the shape is invalid or a slice has the wrong length for it.
pub fn conv2d_weight_gradient(
    shape: &ConvShape,
    input: &[f32],
    gradient: &[f32],
    grid: GridSize,
    weight_gradient: &mut [f32],
    bias_gradient: Option<&mut [f32]>,
) -> Result<()> {
    shape.check()?;
    let target = shape.output(grid);
    check_length("convolution input", input, grid.pixels() * shape.inputs)?;
    check_length(
        "convolution output gradient",
        gradient,
        target.pixels() * shape.outputs,
    )?;
    check_length("weight gradient", weight_gradient, shape.weights())?;

    let rows = (PIXELS_A_PASS / target.width.max(1)).clamp(1, target.height.max(1));
    let passes = target.height.div_ceil(rows);
    let tasks = grid.images * passes;
    let depth = shape.kernel * shape.kernel * shape.inputs;
    let mut parts: Vec<Panels> = (0..PARTS)
        .into_par_iter()
        .map(|part| {
            let mut sums = Panels::zeros(depth, shape.outputs);
            BUFFERS.with_borrow_mut(|buffers| {
                for task in tasks * part / PARTS..tasks * (part + 1) / PARTS {
                    let (image, first) = (task / passes, task % passes * rows);
                    let count = rows.min(target.height - first);
                    add_outer(
                        shape,
                        input,
                        gradient,
                        grid,
                        (image, first, count),
                        buffers,
                        &mut sums,
                    );
                }
            });
            sums
        })
        .collect();
    let Some((total, rest)) = parts.split_first_mut() else {
        return Ok(());
    };
    for part in rest {
        for (sum, v) in total.values.iter_mut().zip(&part.values) {
            *sum += v;
        }
        for (sum, v) in total.bias.iter_mut().zip(&part.bias) {
            *sum += v;
        }
    }
    total.unpack(weight_gradient);
    if let Some(bias_gradient) = bias_gradient {
        check_length("bias gradient", bias_gradient, shape.outputs)?;
        for (target, v) in bias_gradient.iter_mut().zip(&total.bias) {
            *target = *v;
        }
    }
    Ok(())
}

#[derive(Default)]
struct Buffers {
    band: Vec<f32>,
    gradient: Vec<f32>,
}

thread_local! {
    static BUFFERS: RefCell<Buffers> = RefCell::default();
}

/// Adds the share of some output rows of an image to `sums`.
fn add_outer(
    shape: &ConvShape,
    input: &[f32],
    gradient: &[f32],
    grid: GridSize,
    (image, first, count): (usize, usize, usize),
    buffers: &mut Buffers,
    sums: &mut Panels,
) {
    let target = shape.output(grid);
    let pad = (shape.kernel / 2) as isize;
    let size = grid.height * grid.width * shape.inputs;
    let row = target.width * shape.outputs;
    let start = (image * target.height + first) * row;
    let (Some(source), Some(gradient)) = (
        input.get(image * size..(image + 1) * size),
        gradient.get(start..start + count * row),
    ) else {
        return;
    };
    let columns = (target.width - 1) * shape.stride + shape.kernel;
    Band {
        image: (grid.height, grid.width, shape.inputs),
        upsample: shape.upsample,
        origin: ((first * shape.stride) as isize - pad, -pad),
        size: ((count - 1) * shape.stride + shape.kernel, columns),
    }
    .copy(source, &mut buffers.band);

    for pixel in gradient.chunks_exact(shape.outputs) {
        for (sum, v) in sums.bias.iter_mut().zip(pixel) {
            *sum += v;
        }
    }
    // The kernel reads whole vectors.
    let width = shape.outputs.next_multiple_of(LANES);
    let gradient = if width == shape.outputs {
        gradient
    } else {
        buffers.gradient.clear();
        buffers.gradient.resize(count * target.width * width, 0.0);
        for (to, from) in buffers
            .gradient
            .chunks_exact_mut(width)
            .zip(gradient.chunks_exact(shape.outputs))
        {
            for (to, from) in to.iter_mut().zip(from) {
                *to = *from;
            }
        }
        buffers.gradient.as_slice()
    };
    let pitch = columns * shape.inputs;
    let run = shape.kernel * shape.inputs;
    let panels: Vec<_> = sums.iter().collect();
    for (vectors, panel, channel) in panels {
        for tap_row in 0..shape.kernel {
            let kernel = Outer {
                input: buffers.band.as_ptr().wrapping_add(tap_row * pitch),
                input_step: shape.stride * shape.inputs,
                input_pitch: shape.stride * pitch,
                run,
                gradient: gradient.as_ptr().wrapping_add(channel),
                gradient_step: width,
                gradient_pitch: target.width * width,
                vectors,
                pixels: target.width,
                rows: count,
                sums: sums
                    .values
                    .as_mut_ptr()
                    .wrapping_add(panel + tap_row * run * vectors * LANES),
            };
            // SAFETY: the band has `kernel` rows of taps for each output row and `columns` pixels
            // in each row; `gradient` has `count` rows of whole vectors; the panel has
            // `kernel * run` rows; the panels were cut for an instruction set that was detected.
            unsafe { kernel.run(sums.set) };
        }
    }
}
