//! Convolutions of 3x3 taps with stride 1 by fewer multiplications: Winograd's F(2x2, 3x3).
//!
//! Source: Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks", arXiv 1509.09308, section 4.1. Two by two
//! outputs take 16 products of transformed inputs and weights instead of 36. Transforms are additions, in f32, of which
//! the rounding is that of a sum in another order. Products of bf16 round what was transformed.

use rayon::prelude::*;

use super::band::{Band, Banded};
use super::target::Target;
use super::tile::{Rectangle, Tile};
use super::{ConvShape, Fused, GridSize};
use crate::ops::buffer::Buffer;
use crate::ops::element::Element;
use crate::ops::group_norm::Normalisation;
use crate::ops::kernel::Product;
use crate::ops::panel_product::{Rows, product_as_is};
use crate::ops::panels::Panels;
#[cfg(target_arch = "aarch64")]
use crate::ops::simd::Neon;
#[cfg(target_arch = "x86_64")]
use crate::ops::simd::{Avx2, Avx512};
use crate::ops::simd::{InstructionSet, LANES, Lanes, Portable};

/// Inputs of a square of outputs, in each direction, and products of it.
const SIDE: usize = 4;
const PRODUCTS: usize = SIDE * SIDE;

/// Outputs of a square, in each direction.
const OUTPUTS: usize = 2;

/// Rows and columns of outputs that one task computes: enough squares for weights to be used often once they are there.
const TASK: usize = 16;

/// Channels from which on the multiplications that are saved are more than the transforms cost; products of bf16 cost half
/// as much.
const LEAST_CHANNELS: usize = 32;
const LEAST_BF16_CHANNELS: usize = 48;

/// Transformed weights.
#[derive(Clone, Debug)]
pub(super) struct Winograd<P: Product> {
    /// What computes the products.
    unit: P::Unit,
    /// A matrix (inputs x outputs) for each of the products.
    matrices: Vec<Panels<P::Weight>>,
    bias: Vec<f32>,
    inputs: usize,
    outputs: usize,
}

/// Whether convolutions of `shape` are computed faster so than the direct way, in bf16 or in f32.
pub(super) fn suits(shape: &ConvShape, is_bf16: bool) -> bool {
    let least = if is_bf16 {
        LEAST_BF16_CHANNELS
    } else {
        LEAST_CHANNELS
    };
    let suits = |channels: usize| channels >= least && channels.is_multiple_of(LANES);
    shape.kernel == 3
        && shape.stride == 1
        && !shape.upsample
        && suits(shape.inputs)
        && suits(shape.outputs)
}

impl<P: Product<Scales = ()>> Winograd<P> {
    /// Transforms `weight` (3, 3, inputs, outputs), for `unit`.
    pub(super) fn new(
        unit: P::Unit,
        shape: &ConvShape,
        weight: &[f32],
        bias: Option<&[f32]>,
    ) -> Self {
        let ConvShape {
            inputs, outputs, ..
        } = *shape;
        let matrices = (0..PRODUCTS).map(|product| {
            let (rows, columns) = (factors(product / SIDE), factors(product % SIDE));
            Panels::pack_rows(inputs, outputs, None, |k, first, row| {
                for (y, by_row) in rows.iter().enumerate() {
                    for (x, by_column) in columns.iter().enumerate() {
                        let factor = by_row * by_column;
                        if factor == 0.0 {
                            continue;
                        }
                        let at = ((y * 3 + x) * inputs + k) * outputs + first;
                        let taps = weight.get(at..at + row.len()).unwrap_or_default();
                        for (sum, tap) in row.iter_mut().zip(taps) {
                            // Exact, as factors are powers of two.
                            *sum += factor * tap;
                        }
                    }
                }
            })
        });
        Self {
            unit,
            matrices: matrices.collect(),
            bias: bias.map_or_else(|| vec![0.0; outputs], <[f32]>::to_vec),
            inputs,
            outputs,
        }
    }

    /// Writes the convolution of `input` (grid, inputs) to `length` values at `output` (grid, outputs), which need not be
    /// initialised.
    ///
    /// # Safety
    /// `length` values must be writable at `output`.
    pub(super) unsafe fn run(
        &self,
        input: &[f32],
        grid: GridSize,
        fused: Fused<'_>,
        output: *mut f32,
        length: usize,
    ) {
        // What is below trusts these; they hold by construction in this module's callers.
        assert_eq!(
            input.len(),
            grid.pixels() * self.inputs,
            "input of a convolution"
        );
        assert_eq!(
            length,
            grid.pixels() * self.outputs,
            "output of a convolution"
        );
        assert!(fused.residual.is_none_or(|r| r.len() == length));
        if length == 0 {
            return;
        }
        let tile = Tile::square(TASK);
        let tiles = tile.count(grid.height, grid.width);
        let target = Target(output);
        let image = grid.height * grid.width;
        (0..grid.images * tiles).into_par_iter().for_each(|task| {
            let number = task / tiles;
            let part = tile.part(task % tiles, grid.height, grid.width);
            let source = input
                .get(number * image * self.inputs..)
                .unwrap_or_default();
            let normalisation = fused.normalisations.and_then(|all| all.get(number));
            let products = self.products(source, grid, normalisation, part);
            let residual = fused.residual.map(|all| {
                let from = number * image * self.outputs;
                all.get(from..from + image * self.outputs)
                    .unwrap_or_default()
            });
            let first = number * image * self.outputs;
            // SAFETY: the image's values begin there, and no other task writes this rectangle of them.
            unsafe {
                let target = target.at(first);
                self.finish(&products, grid, part, (residual, fused.relu), target);
            }
        });
    }

    /// The products (products, squares, outputs; [`step`] apart) of the squares of outputs of `part`, row by row.
    fn products(
        &self,
        source: &[f32],
        grid: GridSize,
        normalisation: Option<&Normalisation>,
        part: Rectangle,
    ) -> Buffer {
        let (rows, columns) = squares(part);
        let count = rows * columns;
        let values = PRODUCTS * step(count, self.inputs);
        let mut inputs = Buffer::of(values * size_of::<P::Input>() / size_of::<f32>());
        let inputs: &mut [P::Input] = bytemuck::cast_slice_mut(&mut inputs);
        f32::with_buffer(|band| {
            let width = OUTPUTS * columns + OUTPUTS;
            Band {
                image: (grid.height, grid.width, self.inputs),
                origin: (part.top as isize - 1, part.left as isize - 1),
                size: (OUTPUTS * rows + OUTPUTS, width),
                channels: self.inputs,
            }
            .copy(source, normalisation, band);
            let transform = Inputs {
                band: &band.values,
                width,
                channels: self.inputs,
                squares: (rows, columns),
                step: step(count, self.inputs),
            };
            transform_inputs(&transform, inputs);
        });
        let mut products = Buffer::of(PRODUCTS * step(count, self.outputs));
        let parts = products.chunks_exact_mut(step(count, self.outputs));
        let inputs = inputs.chunks_exact(step(count, self.inputs));
        for (matrix, (input, product)) in self.matrices.iter().zip(inputs.zip(parts)) {
            let input = Rows {
                values: input,
                step: self.inputs,
                count,
            };
            let product = Rows {
                values: product,
                step: self.outputs,
                count,
            };
            product_as_is::<P>(self.unit, matrix, input, product);
        }
        products
    }

    /// Writes the outputs of `part`.
    ///
    /// # Safety
    /// The outputs of a whole image must be writable at `target`.
    unsafe fn finish(
        &self,
        products: &[f32],
        grid: GridSize,
        part: Rectangle,
        (residual, relu): (Option<&[f32]>, bool),
        target: *mut f32,
    ) {
        let (rows, columns) = squares(part);
        let outputs = self.outputs;
        let mut square = Buffer::of(OUTPUTS * OUTPUTS * outputs);
        let transform = Products {
            values: products,
            step: step(rows * columns, outputs),
            bias: &self.bias,
        };
        for number in 0..rows * columns {
            transform_products(&transform, number, &mut square);
            let (top, left) = (number / columns * OUTPUTS, number % columns * OUTPUTS);
            for (place, values) in square.chunks_exact_mut(outputs).enumerate() {
                let (y, x) = (top + place / OUTPUTS, left + place % OUTPUTS);
                if y >= part.height || x >= part.width {
                    continue;
                }
                let at = ((part.top + y) * grid.width + part.left + x) * outputs;
                if let Some(residual) = residual.and_then(|all| all.get(at..at + outputs)) {
                    for (value, residual) in values.iter_mut().zip(residual) {
                        *value += residual;
                    }
                }
                if relu {
                    values.iter_mut().for_each(|value| *value = value.max(0.0));
                }
                // SAFETY: the pixel lies in the image, as the part does.
                unsafe {
                    std::ptr::copy_nonoverlapping(values.as_ptr(), target.add(at), outputs);
                }
            }
        }
    }
}

/// Rows and columns of squares that cover a rectangle of outputs.
fn squares(part: Rectangle) -> (usize, usize) {
    (part.height.div_ceil(OUTPUTS), part.width.div_ceil(OUTPUTS))
}

/// Values from those of one product to those of the next: a cache line more than there are, because those of a power of two
/// would share a few places of a cache.
fn step(count: usize, channels: usize) -> usize {
    count * channels + LANES
}

/// Row `row` of the paper's G.
fn factors(row: usize) -> [f32; 3] {
    match row {
        0 => [1.0, 0.0, 0.0],
        1 => [0.5, 0.5, 0.5],
        2 => [0.5, -0.5, 0.5],
        _ => [0.0, 0.0, 1.0],
    }
}

/// The paper's B^T times four values.
#[inline(always)]
fn to_products<L: Lanes>([a, b, c, d]: [L; SIDE]) -> [L; SIDE] {
    [a.sub(c), b.add(c), c.sub(b), b.sub(d)]
}

/// The paper's A^T times four values.
#[inline(always)]
fn from_products<L: Lanes>([a, b, c, d]: [L; SIDE]) -> [L; OUTPUTS] {
    [a.add(b).add(c), b.sub(c).sub(d)]
}

/// The inputs of squares, to be transformed.
struct Inputs<'a> {
    /// (rows, `width`, channels), the first pixel that of the first square.
    band: &'a [f32],
    width: usize,
    channels: usize,
    /// Rows and columns of squares.
    squares: (usize, usize),
    /// From one product's values to the next's in what is written.
    step: usize,
}

impl Inputs<'_> {
    /// Writes the transformed inputs (products, squares, channels).
    #[inline(always)]
    fn transform<L: Lanes, T: Element>(&self, out: &mut [T]) {
        let (rows, columns) = self.squares;
        let pitch = self.width * self.channels;
        assert!(self.band.len() >= (OUTPUTS * rows + OUTPUTS) * pitch);
        assert!(self.width >= OUTPUTS * columns + OUTPUTS);
        assert!(out.len() >= (PRODUCTS - 1) * self.step + rows * columns * self.channels);
        assert!(self.channels.is_multiple_of(LANES));
        for number in 0..rows * columns {
            let (top, left) = (number / columns * OUTPUTS, number % columns * OUTPUTS);
            let first = top * pitch + left * self.channels;
            for channel in (0..self.channels).step_by(LANES) {
                // SAFETY: a square and its border lie within the band, and whole lanes of channels within a pixel;
                // `out` has room for every product of every square.
                unsafe {
                    let from = self.band.as_ptr().add(first + channel);
                    let to = out.as_mut_ptr().add(number * self.channels + channel);
                    let at = |y: usize, x: usize| L::load(from.add(y * pitch + x * self.channels));
                    let column = |x: usize| to_products([at(0, x), at(1, x), at(2, x), at(3, x)]);
                    let columns = [column(0), column(1), column(2), column(3)];
                    for y in 0..SIDE {
                        let row = to_products(columns.map(|column| column[y]));
                        for (x, values) in row.into_iter().enumerate() {
                            T::store(values, to.add((y * SIDE + x) * self.step));
                        }
                    }
                }
            }
        }
    }
}

/// The products of squares, to be transformed to outputs.
struct Products<'a> {
    /// (products, squares, outputs).
    values: &'a [f32],
    /// From one product's values to the next's.
    step: usize,
    bias: &'a [f32],
}

impl Products<'_> {
    /// The outputs (2, 2, outputs) of square `number`.
    #[inline(always)]
    fn transform<L: Lanes>(&self, number: usize, out: &mut [f32]) {
        let outputs = self.bias.len();
        assert!(self.values.len() >= (PRODUCTS - 1) * self.step + (number + 1) * outputs);
        assert!(out.len() >= OUTPUTS * OUTPUTS * outputs && outputs.is_multiple_of(LANES));
        for channel in (0..outputs).step_by(LANES) {
            // SAFETY: whole lanes of outputs lie within a square's products, within `out` and within the bias.
            unsafe {
                let from = self.values.as_ptr().add(number * outputs + channel);
                let at = |y: usize, x: usize| L::load(from.add((y * SIDE + x) * self.step));
                let column = |x: usize| from_products([at(0, x), at(1, x), at(2, x), at(3, x)]);
                let columns = [column(0), column(1), column(2), column(3)];
                let bias = L::load(self.bias.as_ptr().add(channel));
                for y in 0..OUTPUTS {
                    let row = from_products(columns.map(|column| column[y]));
                    for (x, values) in row.into_iter().enumerate() {
                        let place = (y * OUTPUTS + x) * outputs + channel;
                        values.add(bias).store(out.as_mut_ptr().add(place));
                    }
                }
            }
        }
    }
}

/// Compiles a transform for every instruction set, and calls the machine's.
macro_rules! on_lanes {
    ($name:ident$(<$element:ident>)?, $transform:ty, $($arg:ident: $type:ty),*) => {
        fn $name$(<$element: Element>)?(transform: &$transform, $($arg: $type),*) {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f")]
            fn avx512$(<$element: Element>)?(transform: &$transform, $($arg: $type),*) {
                transform.transform::<Avx512$(, $element)?>($($arg),*);
            }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2$(<$element: Element>)?(transform: &$transform, $($arg: $type),*) {
                transform.transform::<Avx2$(, $element)?>($($arg),*);
            }

            match InstructionSet::detect() {
                #[cfg(target_arch = "x86_64")]
                // SAFETY: the processor was found to have these instructions.
                InstructionSet::Avx512 => unsafe { avx512(transform, $($arg),*) },
                #[cfg(target_arch = "x86_64")]
                // SAFETY: as above.
                InstructionSet::Avx2 => unsafe { avx2(transform, $($arg),*) },
                #[cfg(target_arch = "aarch64")]
                InstructionSet::Neon => transform.transform::<Neon$(, $element)?>($($arg),*),
                InstructionSet::Portable => transform.transform::<Portable$(, $element)?>($($arg),*),
            }
        }
    };
}

on_lanes!(transform_inputs<T>, Inputs<'_>, out: &mut [T]);
on_lanes!(transform_products, Products<'_>, number: usize, out: &mut [f32]);
