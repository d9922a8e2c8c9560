//! Gradients of a convolution.

use std::cell::RefCell;

use rayon::prelude::*;

use super::band::{Band, BandBuffer};
use super::phase::Phase;
use super::sweep::{Output, Sweep};
use super::{ConvShape, GridSize};
use crate::Result;
use crate::ops::kernel::Outer;
use crate::ops::length::check_length;
use crate::ops::panels::Panels;
use crate::ops::product::F32;
use crate::ops::simd::LANES;

/// Parts into which the sum over images is split. It is fixed, and the parts are added in order,
/// so that the sum does not depend on the number of threads.
const PARTS: usize = 8;

/// Values of the weight gradient that one task adds up.
const BLOCK: usize = 16 * 1024;

/// Pixels that a tile of the weight gradient sums over before it goes back to memory.
const PIXELS_A_PASS: usize = 64;

/// Gradient by the input of [`super::PackedConv::run`], given the `gradient` by its output.
///
/// `grid` is the size of the convolution's input. `residual` (of the input's shape) is added, and
/// where `mask` (the same shape) is not positive the result becomes zero: with the convolution's
/// input as mask that is the gradient through the ReLU that made the input. All of `output` is written.
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
    output: &mut [f32],
) -> Result<()> {
    shape.check()?;
    let target = shape.output(grid);
    let length = grid.pixels() * shape.inputs;
    check_length("convolution input gradient", output, length)?;
    check_length("convolution weights", weight, shape.weights())?;
    check_length(
        "convolution output gradient",
        gradient,
        target.pixels() * shape.outputs,
    )?;
    for slice in [residual, mask].into_iter().flatten() {
        check_length("convolution residual or mask", slice, length)?;
    }
    let back = Back {
        shape,
        weight,
        gradient,
        grid,
        residual,
        mask,
    };
    match shape.upsample {
        true => back.sweep_doubled(output),
        false => back.sweep(output),
    }
    Ok(())
}

/// What [`conv2d_input_gradient`] is given, checked.
struct Back<'a> {
    shape: &'a ConvShape,
    weight: &'a [f32],
    gradient: &'a [f32],
    grid: GridSize,
    residual: Option<&'a [f32]>,
    mask: Option<&'a [f32]>,
}

impl Back<'_> {
    /// Writes the input gradient of a convolution without upsampling.
    fn sweep(&self, output: &mut [f32]) {
        let grid = self.grid;
        let ConvShape {
            inputs,
            outputs,
            kernel,
            stride,
            ..
        } = *self.shape;
        for row in 0..stride.min(grid.height) {
            for column in 0..stride.min(grid.width) {
                // Input rows of this parity get a share from the taps of one parity only.
                let (rows, row_pad) = taps(kernel, stride, row);
                let (columns, column_pad) = taps(kernel, stride, column);
                let taps = rows.iter().flat_map(|row| {
                    let of_row = columns.iter().map(|column| self.tap(*row, *column));
                    of_row.collect::<Vec<_>>()
                });
                let taps: Vec<&[f32]> = taps.collect();
                let panels = Panels::pack_all_transposed(outputs, inputs, &taps);
                let taps = (rows.len(), columns.len());
                self.over_gradient(&panels, taps, 1, (row_pad, column_pad))
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

    /// Writes the input gradient of a convolution of a doubled input: a convolution with stride 2, whose taps are sums of the
    /// kernel's.
    fn sweep_doubled(&self, output: &mut [f32]) {
        let grid = self.grid;
        let ConvShape {
            inputs,
            outputs,
            kernel,
            ..
        } = *self.shape;
        // Two rows of the doubled input are one of the input; a row of outputs sees each through a tap, if it has one there.
        let merged = |row: usize| {
            let last = kernel.saturating_sub(row).min(kernel.saturating_sub(1));
            let first = kernel.saturating_sub(row + 1);
            first..=last
        };
        let sides = kernel + 1;
        let sums: Vec<Vec<f32>> = (0..sides * sides)
            .map(|at| {
                let mut sum = vec![0.0; inputs * outputs];
                for row in merged(at / sides) {
                    for column in merged(at % sides) {
                        for (sum, w) in sum.iter_mut().zip(self.tap(row, column)) {
                            *sum += w;
                        }
                    }
                }
                sum
            })
            .collect();
        let taps: Vec<&[f32]> = sums.iter().map(Vec::as_slice).collect();
        let panels = Panels::pack_all_transposed(outputs, inputs, &taps);
        let pad = (kernel / 2) as isize;
        self.over_gradient(&panels, (sides, sides), 2, (pad, pad))
            .run(
                Output {
                    height: grid.height,
                    width: grid.width,
                    start: 0,
                    pixel_step: inputs,
                    row_step: grid.width * inputs,
                    image_step: grid.height * grid.width * inputs,
                },
                output,
            );
    }

    /// A convolution of the gradient, whose outputs are the input's gradient.
    fn over_gradient<'s>(
        &'s self,
        panels: &'s Panels,
        taps: (usize, usize),
        stride: usize,
        pad: (isize, isize),
    ) -> Sweep<'s, F32> {
        Sweep {
            input: self.gradient,
            grid: self.shape.output(self.grid),
            channels: self.shape.outputs,
            taps,
            stride,
            pad,
            panels,
            unit: panels.set,
            normalisations: None,
            residual: self.residual,
            mask: self.mask,
            relu: false,
        }
    }

    /// The weights of a tap, (inputs x outputs).
    fn tap(&self, row: usize, column: usize) -> &[f32] {
        let size = self.shape.inputs * self.shape.outputs;
        let at = (row * self.shape.kernel + column) * size;
        self.weight.get(at..at + size).unwrap_or_default()
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

    let phases = Phase::all(shape);
    let scale = Phase::scale(shape);
    let depths = phases.iter().map(|phase| {
        let (rows, columns) = phase.taps();
        rows * columns * shape.inputs
    });
    let depth = depths.sum();
    let (height, width) = (target.height / scale, target.width / scale);
    let rows = (PIXELS_A_PASS / width.max(1)).clamp(1, height.max(1));
    let passes = height.div_ceil(rows);
    let tasks = grid.images * passes;
    let outer = Outers {
        shape,
        phases: &phases,
        input,
        gradient,
        grid,
    };
    let mut parts: Vec<Panels> = (0..PARTS)
        .into_par_iter()
        .map(|part| {
            let mut sums = Panels::zeros(depth, shape.outputs);
            BUFFERS.with_borrow_mut(|buffers| {
                for task in tasks * part / PARTS..tasks * (part + 1) / PARTS {
                    let (image, first) = (task / passes, task % passes * rows);
                    let count = rows.min(height - first);
                    outer.add((image, first, count), buffers, &mut sums);
                }
            });
            sums
        })
        .collect();
    let Some((total, rest)) = parts.split_first_mut() else {
        return Ok(());
    };
    let blocks = total.values.par_chunks_mut(BLOCK).enumerate();
    blocks.for_each(|(block, sums)| {
        for part in rest.iter() {
            let values = part.values.get(block * BLOCK..).unwrap_or_default();
            for (sum, v) in sums.iter_mut().zip(values) {
                *sum += v;
            }
        }
    });
    for part in rest {
        for (sum, v) in total.bias.iter_mut().zip(&part.bias) {
            *sum += v;
        }
    }
    if shape.upsample {
        let mut merged = vec![0.0; depth * shape.outputs];
        total.unpack(&mut merged);
        spread(shape, &phases, &merged, weight_gradient);
    } else {
        total.unpack(weight_gradient);
    }
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
    band: BandBuffer<f32>,
    gradient: Vec<f32>,
}

thread_local! {
    static BUFFERS: RefCell<Buffers> = RefCell::default();
}

/// Pixels of whole vectors, which the kernel reads, and the length of one: `pixels` as they are, or padded in `buffer`.
fn whole_vectors<'a>(
    pixels: &'a [f32],
    channels: usize,
    buffer: &'a mut Vec<f32>,
) -> (&'a [f32], usize) {
    let width = channels.next_multiple_of(LANES);
    if width == channels {
        return (pixels, width);
    }
    buffer.clear();
    buffer.resize(pixels.len() / channels * width, 0.0);
    let padded = buffer.chunks_exact_mut(width);
    for (to, from) in padded.zip(pixels.chunks_exact(channels)) {
        for (to, from) in to.iter_mut().zip(from) {
            *to = *from;
        }
    }
    (buffer, width)
}

/// Gives each of the kernel's taps the gradients of all merged taps that it is part of.
fn spread(shape: &ConvShape, phases: &[Phase], merged: &[f32], weight_gradient: &mut [f32]) {
    weight_gradient.fill(0.0);
    let size = (shape.inputs * shape.outputs).max(1);
    let mut merged = merged.chunks_exact(size);
    for phase in phases {
        let (rows, columns) = phase.taps();
        for (number, by_merged) in (0..rows * columns).zip(&mut merged) {
            for tap in phase.merged(number) {
                let by_tap = weight_gradient.get_mut(tap * size..(tap + 1) * size);
                for (sum, v) in by_tap.unwrap_or_default().iter_mut().zip(by_merged) {
                    *sum += v;
                }
            }
        }
    }
}

/// Products of inputs and output gradients, to be summed over pixels.
struct Outers<'a> {
    shape: &'a ConvShape,
    phases: &'a [Phase],
    input: &'a [f32],
    gradient: &'a [f32],
    grid: GridSize,
}

impl Outers<'_> {
    /// Adds the share of `count` rows of an image from row `first` on, where rows are those of a phase, to `sums`.
    fn add(
        &self,
        (image, first, count): (usize, usize, usize),
        buffers: &mut Buffers,
        sums: &mut Panels,
    ) {
        let Self { shape, grid, .. } = *self;
        let target = shape.output(grid);
        let scale = Phase::scale(shape);
        let size = grid.height * grid.width * shape.inputs;
        let row = target.width * shape.outputs;
        let start = (image * target.height + first * scale) * row;
        let (Some(source), Some(gradient)) = (
            self.input.get(image * size..(image + 1) * size),
            self.gradient.get(start..start + count * scale * row),
        ) else {
            return;
        };
        // Wide enough for all phases.
        let most = |of: fn(&Phase) -> isize| self.phases.iter().map(of).max().unwrap_or_default();
        let pad = (most(|phase| phase.pad.0), most(|phase| phase.pad.1));
        let reach = (
            most(|phase| phase.rows.len() as isize - phase.pad.0),
            most(|phase| phase.columns.len() as isize - phase.pad.1),
        );
        let side = |pixels: usize, pad: isize, reach: isize| {
            (pixels.saturating_sub(1) * shape.stride).saturating_add_signed(pad + reach)
        };
        let width = target.width / scale;
        let columns = side(width, pad.1, reach.1);
        Band {
            image: (grid.height, grid.width, shape.inputs),
            origin: ((first * shape.stride) as isize - pad.0, -pad.1),
            size: (side(count, pad.0, reach.0), columns),
            channels: shape.inputs,
        }
        .copy(source, None, &mut buffers.band);

        for pixel in gradient.chunks_exact(shape.outputs) {
            for (sum, v) in sums.bias.iter_mut().zip(pixel) {
                *sum += v;
            }
        }
        let (gradient, step) = whole_vectors(gradient, shape.outputs, &mut buffers.gradient);
        let pitch = columns * shape.inputs;
        let panels: Vec<_> = sums.iter().collect();
        for (vectors, panel, channel) in panels {
            let mut depth = 0;
            for phase in self.phases {
                let (tap_rows, tap_columns) = phase.taps();
                let run = tap_columns * shape.inputs;
                let before = (
                    (pad.0 - phase.pad.0).unsigned_abs(),
                    (pad.1 - phase.pad.1).unsigned_abs(),
                );
                let from = (phase.origin.0 * target.width + phase.origin.1) * step + channel;
                for tap_row in 0..tap_rows {
                    let at = (before.0 + tap_row) * pitch + before.1 * shape.inputs;
                    let kernel = Outer {
                        input: buffers.band.values.as_ptr().wrapping_add(at),
                        input_step: shape.stride * shape.inputs,
                        input_pitch: shape.stride * pitch,
                        run,
                        gradient: gradient.as_ptr().wrapping_add(from),
                        gradient_step: scale * step,
                        gradient_pitch: scale * target.width * step,
                        vectors,
                        pixels: width,
                        rows: count,
                        sums: sums
                            .values
                            .as_mut_ptr()
                            .wrapping_add(panel + depth * vectors * LANES),
                    };
                    // SAFETY: the band reaches from the first tap of the first pixel to the last tap of the last one,
                    // for every phase; `gradient` has `count` rows of whole vectors for each phase; the panel has as
                    // many rows as all phases have taps and inputs; the panels were cut for an instruction set that
                    // was detected.
                    unsafe { kernel.run(sums.set) };
                    depth += run;
                }
            }
        }
    }
}
