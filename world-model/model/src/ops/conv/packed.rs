//! A convolution whose weights are in the order of the kernel: packed once, run often.

use half::bf16;

use super::band::Banded;
use super::phase::Phase;
use super::sweep::{Output, Sweep, whole_channels};
use super::winograd::{self, Winograd};
use super::{ConvShape, Fused, GridSize};
use crate::NumberFormat;
use crate::ops::element::Element;
use crate::ops::kernel::Product;
use crate::ops::length::check_length;
use crate::ops::panels::Panels;
use crate::ops::product::{Bf16, F32};
use crate::ops::simd::{Bf16Unit, InstructionSet};
use crate::{Error, Result};

/// A convolution with packed weights.
#[derive(Clone, Debug)]
pub struct PackedConv {
    shape: ConvShape,
    parts: Parts,
    /// Whether the border is one row below and one column on the right only.
    borders_lower_right: bool,
}

#[derive(Clone, Debug)]
enum Parts {
    F32(Vec<Part<f32>>),
    Bf16(Bf16Unit, Vec<Part<bf16>>),
    WinogradF32(Winograd<F32>),
    WinogradBf16(Winograd<Bf16>),
}

/// A convolution of the input as it is in memory that gives some of the outputs.
#[derive(Clone, Debug)]
struct Part<T: Element> {
    panels: Panels<T>,
    phase: Phase,
}

impl<T: Element> Part<T> {
    fn all(shape: &ConvShape, weight: &[f32], bias: Option<&[f32]>) -> Vec<Self> {
        let ConvShape {
            inputs, outputs, ..
        } = *shape;
        let whole = whole_channels::<T>(inputs);
        let parts = Phase::all(shape).into_iter().map(|phase| {
            let (rows, columns) = phase.taps();
            let panels =
                Panels::pack_rows(rows * columns * whole, outputs, bias, |k, first, row| {
                    let (tap, channel) = (k / whole, k % whole);
                    if channel >= inputs {
                        return;
                    }
                    for tap in phase.merged(tap) {
                        let at = (tap * inputs + channel) * outputs + first;
                        let weights = weight.get(at..at + row.len()).unwrap_or_default();
                        for (sum, w) in row.iter_mut().zip(weights) {
                            *sum += w;
                        }
                    }
                });
            Self { panels, phase }
        });
        parts.collect()
    }
}

impl PackedConv {
    /// Packs `weight` (kernel row, kernel column, inputs, outputs) and `bias` (outputs): in bf16 where `format` is not f32
    /// and the processor has products of it, else in f32.
    ///
    /// # Errors
    /// If the shape is invalid or a slice has the wrong length for it.
    pub fn new(
        shape: &ConvShape,
        weight: &[f32],
        bias: Option<&[f32]>,
        format: NumberFormat,
    ) -> Result<Self> {
        Self::of_unit(shape, weight, bias, format.bf16_unit())
    }

    /// In bf16 for `unit`, or else in f32.
    pub(super) fn of_unit(
        shape: &ConvShape,
        weight: &[f32],
        bias: Option<&[f32]>,
        unit: Option<Bf16Unit>,
    ) -> Result<Self> {
        check_weights(shape, weight, bias)?;
        let parts = match unit {
            Some(unit) => Parts::Bf16(unit, Part::all(shape, weight, bias)),
            None => Parts::F32(Part::all(shape, weight, bias)),
        };
        Ok(Self {
            shape: *shape,
            parts,
            borders_lower_right: false,
        })
    }

    /// As [`PackedConv::new`], for weights that do not change: where it is faster, they are transformed, to 16/9 of their
    /// size.
    ///
    /// # Errors
    /// As [`PackedConv::new`].
    pub fn for_inference(
        shape: &ConvShape,
        weight: &[f32],
        bias: Option<&[f32]>,
        format: NumberFormat,
    ) -> Result<Self> {
        Self::transformed(shape, weight, bias, format.bf16_unit())
    }

    /// As [`Self::of_unit`], transformed where that is faster.
    pub(super) fn transformed(
        shape: &ConvShape,
        weight: &[f32],
        bias: Option<&[f32]>,
        unit: Option<Bf16Unit>,
    ) -> Result<Self> {
        if !winograd::suits(shape, unit.is_some()) {
            return Self::of_unit(shape, weight, bias, unit);
        }
        check_weights(shape, weight, bias)?;
        let parts = match unit {
            Some(unit) => Parts::WinogradBf16(Winograd::new(unit, shape, weight, bias)),
            None => {
                let set = InstructionSet::detect();
                Parts::WinogradF32(Winograd::new(set, shape, weight, bias))
            }
        };
        Ok(Self {
            shape: *shape,
            parts,
            borders_lower_right: false,
        })
    }

    /// As [`PackedConv::new`] of a 3x3 convolution with stride 2 whose border is one row below and one column on the
    /// right, as latent diffusion's autoencoders halve a picture; odd sizes are rounded down.
    ///
    /// # Errors
    /// As [`PackedConv::new`], or if it is no such convolution.
    pub fn halving_lower_right(
        shape: &ConvShape,
        weight: &[f32],
        bias: Option<&[f32]>,
        format: NumberFormat,
    ) -> Result<Self> {
        if *shape != ConvShape::down(shape.inputs, shape.outputs) {
            let reason = format!("{shape:?}, expected a 3x3 kernel with stride 2");
            return Err(Error::config("convolution", reason));
        }
        let mut packed = Self::new(shape, weight, bias, format)?;
        match &mut packed.parts {
            Parts::F32(parts) => parts.iter_mut().for_each(|part| part.phase.pad = (0, 0)),
            Parts::Bf16(_, parts) => parts.iter_mut().for_each(|part| part.phase.pad = (0, 0)),
            // Of stride 1 only.
            Parts::WinogradF32(_) | Parts::WinogradBf16(_) => {}
        }
        packed.borders_lower_right = true;
        Ok(packed)
    }

    /// Size of the output for an input of size `grid`.
    fn output(&self, grid: GridSize) -> GridSize {
        if self.borders_lower_right {
            return GridSize {
                images: grid.images,
                height: grid.height / 2,
                width: grid.width / 2,
            };
        }
        self.shape.output(grid)
    }

    /// Convolves `input` (grid, input channels) to `output` (output grid, output channels), which
    /// is resized as needed; returns the output grid.
    ///
    /// # Errors
    /// If a slice has the wrong length for the grid.
    pub fn run(
        &self,
        input: &[f32],
        grid: GridSize,
        fused: Fused<'_>,
        output: &mut Vec<f32>,
    ) -> Result<GridSize> {
        let shape = &self.shape;
        check_length("convolution input", input, grid.pixels() * shape.inputs)?;
        let target = self.output(grid);
        let length = target.pixels() * shape.outputs;
        if let Some(residual) = fused.residual {
            check_length("convolution residual", residual, length)?;
        }
        let normalisations = fused.normalisations.map_or(grid.images, <[_]>::len);
        if normalisations != grid.images {
            return Err(Error::Shape {
                what: "the normalisations of a convolution's input",
                expected: format!("{}, one an image", grid.images),
                found: vec![normalisations],
            });
        }
        // Not filled first: for a large picture that takes as long as reading it.
        output.clear();
        output.reserve_exact(length);
        let run = Run {
            shape,
            input,
            grid,
            target,
            fused,
            output: output.as_mut_ptr(),
            length,
        };
        // SAFETY: room for `length` values was reserved, and the phases together write them all.
        unsafe {
            match &self.parts {
                Parts::F32(parts) => run.all::<F32>(parts, InstructionSet::detect()),
                Parts::Bf16(unit, parts) => run.all::<Bf16>(parts, *unit),
                Parts::WinogradF32(winograd) => {
                    winograd.run(input, grid, fused, output.as_mut_ptr(), length);
                }
                Parts::WinogradBf16(winograd) => {
                    winograd.run(input, grid, fused, output.as_mut_ptr(), length);
                }
            }
            output.set_len(length);
        }
        Ok(target)
    }
}

fn check_weights(shape: &ConvShape, weight: &[f32], bias: Option<&[f32]>) -> Result<()> {
    shape.check()?;
    check_length("convolution weights", weight, shape.weights())?;
    bias.map_or(Ok(()), |bias| {
        check_length("convolution bias", bias, shape.outputs)
    })
}

/// One run of a convolution.
struct Run<'a> {
    shape: &'a ConvShape,
    input: &'a [f32],
    grid: GridSize,
    target: GridSize,
    fused: Fused<'a>,
    output: *mut f32,
    length: usize,
}

impl Run<'_> {
    /// Writes the outputs of `parts`.
    ///
    /// # Safety
    /// `length` values must be writable at `output`, and the processor must have `unit`.
    unsafe fn all<P: Product<Scales = ()>>(&self, parts: &[Part<P::Weight>], unit: P::Unit)
    where
        P::Input: Banded,
    {
        let (shape, target) = (self.shape, self.target);
        let scale = Phase::scale(shape);
        let pitch = target.width * shape.outputs;
        for part in parts {
            let (row, column) = part.phase.origin;
            let sweep = Sweep::<P> {
                input: self.input,
                grid: self.grid,
                channels: shape.inputs,
                taps: part.phase.taps(),
                stride: shape.stride,
                pad: part.phase.pad,
                panels: &part.panels,
                unit,
                normalisations: self.fused.normalisations,
                residual: self.fused.residual,
                mask: None,
                relu: self.fused.relu,
            };
            let out = Output {
                height: target.height / scale,
                width: target.width / scale,
                start: row * pitch + column * shape.outputs,
                pixel_step: scale * shape.outputs,
                row_step: scale * pitch,
                image_step: target.height * pitch,
            };
            // SAFETY: as for this function.
            unsafe { sweep.run_at(out, self.output, self.length) };
        }
    }
}
