//! A convolution whose weights are in the order of the kernel: packed once, run often.

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
    /// Rows and columns of taps.
    taps: (usize, usize),
    /// How far the first tap lies before the output's own place.
    pad: (isize, isize),
    /// Row and column of the first output.
    origin: (usize, usize),
}

impl PackedConv {
    /// Packs `weight` (kernel row, kernel column, inputs, outputs) and `bias` (outputs).
    ///
    /// Where the input is doubled first, outputs of one parity of row and column see each input
    /// through several taps: their sum is one tap, so that four convolutions with a quarter of the
    /// outputs each do less than half the work of one over the doubled input.
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
            inputs,
            outputs,
            kernel,
            upsample,
            ..
        } = *shape;
        let scale = if upsample { 2 } else { 1 };
        let mut parts = Vec::with_capacity(scale * scale);
        for row in 0..scale {
            for column in 0..scale {
                let (rows, row_pad) = merged_taps(kernel, scale, row);
                let (columns, column_pad) = merged_taps(kernel, scale, column);
                let depth = rows.len() * columns.len() * inputs;
                let panels = Panels::pack(depth, outputs, bias, |k, n| {
                    let (tap, input) = (k / inputs, k % inputs);
                    let rows = rows.get(tap / columns.len()).into_iter().flatten();
                    rows.flat_map(|row| {
                        let columns = columns.get(tap % columns.len()).into_iter().flatten();
                        columns.map(move |column| row * kernel + column)
                    })
                    .filter_map(|tap| weight.get((tap * inputs + input) * outputs + n))
                    .sum()
                });
                parts.push(Part {
                    panels,
                    taps: (rows.len(), columns.len()),
                    pad: (row_pad, column_pad),
                    origin: (row, column),
                });
            }
        }
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
            part.pad = (0, 0);
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
        let scale = if shape.upsample { 2 } else { 1 };
        let pitch = target.width * shape.outputs;
        for part in &self.parts {
            let (row, column) = part.origin;
            Sweep {
                input,
                grid,
                channels: shape.inputs,
                taps: part.taps,
                stride: shape.stride,
                pad: part.pad,
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

/// For the outputs `first`, `first` + `scale`, ..: which of the kernel's taps fall on each input,
/// and how many of these inputs lie before the output's own.
fn merged_taps(kernel: usize, scale: usize, first: usize) -> (Vec<Vec<usize>>, isize) {
    let before = (kernel / 2) as isize;
    let input = |tap: usize| (first as isize + tap as isize - before).div_euclid(scale as isize);
    let mut taps: Vec<Vec<usize>> = Vec::new();
    for tap in 0..kernel {
        match taps.last_mut() {
            Some(merged) if tap > 0 && input(tap) == input(tap - 1) => merged.push(tap),
            _ => taps.push(vec![tap]),
        }
    }
    (taps, -input(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubling_merges_taps() {
        assert_eq!(merged_taps(3, 1, 0), (vec![vec![0], vec![1], vec![2]], 1));
        assert_eq!(merged_taps(3, 2, 0), (vec![vec![0], vec![1, 2]], 1));
        assert_eq!(merged_taps(3, 2, 1), (vec![vec![0, 1], vec![2]], 0));
        assert_eq!(merged_taps(1, 2, 1), (vec![vec![0]], 0));
    }
}
