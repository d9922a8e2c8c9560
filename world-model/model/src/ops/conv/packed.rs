//! A convolution whose weights are in the order of the kernel: packed once, run often.

use super::phase::Phase;
use super::sweep::{Output, Sweep};
use super::{ConvShape, Epilogue, GridSize, check_length};
use crate::ops::panels::Panels;
use crate::{Error, Result};

/// A convolution with packed weights.
#[derive(Clone, Debug)]
pub struct PackedConv {
    shape: ConvShape,
    parts: Vec<Part>,
    /// Whether the border is one row below and one column on the right only.
    borders_lower_right: bool,
}

/// A convolution of the input as it is in memory that gives some of the outputs.
#[derive(Clone, Debug)]
struct Part {
    panels: Panels<f32>,
    phase: Phase,
}

impl PackedConv {
    /// Packs `weight` (kernel row, kernel column, inputs, outputs) and `bias` (outputs).
    ///
    /// # Errors
    /// If the shape is invalid or a slice has the wrong length for it.
    pub fn new(shape: &ConvShape, weight: &[f32], bias: Option<&[f32]>) -> Result<Self> {
        shape.check()?;
        check_length("convolution weights", weight, shape.weights())?;
        if let Some(bias) = bias {
            check_length("convolution bias", bias, shape.outputs)?;
        }
        let ConvShape {
            inputs, outputs, ..
        } = *shape;
        let parts = Phase::all(shape).into_iter().map(|phase| {
            let (rows, columns) = phase.taps();
            let panels =
                Panels::pack_rows(rows * columns * inputs, outputs, bias, |k, first, row| {
                    for tap in phase.merged(k / inputs) {
                        let at = (tap * inputs + k % inputs) * outputs + first;
                        let weights = weight.get(at..at + row.len()).unwrap_or_default();
                        for (sum, w) in row.iter_mut().zip(weights) {
                            *sum += w;
                        }
                    }
                });
            Part { panels, phase }
        });
        let parts = parts.collect();
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
    ) -> Result<Self> {
        if *shape != ConvShape::down(shape.inputs, shape.outputs) {
            let reason = format!("{shape:?}, expected a 3x3 kernel with stride 2");
            return Err(Error::config("convolution", reason));
        }
        let mut packed = Self::new(shape, weight, bias)?;
        for part in &mut packed.parts {
            part.phase.pad = (0, 0);
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
        epilogue: Epilogue<'_>,
        output: &mut Vec<f32>,
    ) -> Result<GridSize> {
        let shape = &self.shape;
        check_length("convolution input", input, grid.pixels() * shape.inputs)?;
        let target = self.output(grid);
        let length = target.pixels() * shape.outputs;
        if let Some(residual) = epilogue.residual {
            check_length("convolution residual", residual, length)?;
        }
        output.resize(length, 0.0);
        let scale = Phase::scale(shape);
        let pitch = target.width * shape.outputs;
        for part in &self.parts {
            let (row, column) = part.phase.origin;
            Sweep {
                input,
                grid,
                channels: shape.inputs,
                taps: part.phase.taps(),
                stride: shape.stride,
                pad: part.phase.pad,
                panels: &part.panels,
                residual: epilogue.residual,
                mask: None,
                relu: epilogue.relu,
            }
            .run(
                Output {
                    height: target.height / scale,
                    width: target.width / scale,
                    start: row * pitch + column * shape.outputs,
                    pixel_step: scale * shape.outputs,
                    row_step: scale * pitch,
                    image_step: target.height * pitch,
                },
                output,
            );
        }
        Ok(target)
    }
}
