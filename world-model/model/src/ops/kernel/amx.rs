//! Rows by the tiles of AMX: two tiles of pixels times one or two vectors of outputs at a time.

use super::{Product, Row, Scales as _};
use crate::ops::simd::LANES;
use crate::ops::simd::amx::{Operands, ROW_BYTES, ROWS, Shapes, Sums, TileProduct};

/// Vectors of outputs that are computed together at most.
const VECTORS: usize = 2;

/// The end of a run that does not fill a row of a tile, with zeros behind it.
#[repr(C, align(64))]
struct Rest {
    inputs: [[[u8; ROW_BYTES]; ROWS]; 2],
    weights: [[[u8; ROW_BYTES]; VECTORS]; ROWS],
}

impl<P: Product> Row<P> {
    /// By tiles, with the products `T` of the formats of `P`.
    ///
    /// Every tile has the same number of rows, so that their shapes are loaded once: the pixels in equal parts. The last
    /// parts are moved forward to the row's end where they would be longer, and their first pixels are not written again.
    ///
    /// # Safety
    /// As for [`Row::run`]; the processor must have the tiles and products, and the system must let this process use them.
    #[inline(always)]
    pub(in crate::ops) unsafe fn amx_tiles<T: TileProduct>(&self) {
        // A vector of groups is a row of a tile.
        const { assert!(LANES * size_of::<f32>() == ROW_BYTES) };
        if self.pixels == 0 {
            return;
        }
        let blocks = self.pixels.div_ceil(2 * ROWS);
        let rows = self.pixels.div_ceil(2 * blocks);
        // SAFETY: as for this function; there are no other shapes, as a row is computed by one thread.
        let shapes = unsafe { Shapes::load(rows) };
        for block in 0..blocks {
            let parts = [2 * block, 2 * block + 1];
            let pixels = parts.map(|part| (part * rows).min(self.pixels - rows));
            for first in (0..self.vectors).step_by(VECTORS) {
                // SAFETY: as for this function.
                unsafe {
                    let start = |vector: usize| {
                        let vector = vector.min(self.vectors - 1);
                        let values = self.scales.starts(self.bias).add(vector * LANES);
                        [values.cast::<[f32; LANES]>().read_unaligned(); ROWS]
                    };
                    let mut sums = Sums([[start(first), start(first + 1)]; 2]);
                    self.add_products::<T>(&shapes, pixels, first, &mut sums);
                    for ((part, from), sums) in parts.iter().zip(pixels).zip(&mut sums.0) {
                        // Of what the part before has.
                        let written = (part * rows).min(self.pixels) - from;
                        for (vector, sums) in (first..self.vectors).zip(sums) {
                            for (row, values) in
                                sums.iter_mut().enumerate().take(rows).skip(written)
                            {
                                self.finish(from + row, vector, values);
                            }
                        }
                    }
                }
            }
        }
    }

    /// Adds to `sums` the products of the pixels from each of `pixels` on with the vectors from `first` on.
    ///
    /// # Safety
    /// As for [`Self::amx_tiles`].
    #[inline(always)]
    unsafe fn add_products<T: TileProduct>(
        &self,
        shapes: &Shapes,
        pixels: [usize; 2],
        first: usize,
        sums: &mut Sums,
    ) {
        let width = (self.vectors - first).min(VECTORS);
        let multiply = |operands: &Operands, sums: &mut Sums| {
            // SAFETY: as for this function.
            unsafe {
                match width {
                    1 => T::add_one(shapes, operands, sums),
                    _ => T::add_two(shapes, operands, sums),
                }
            }
        };
        let of_input = size_of::<P::Input>();
        let (run, tap_pitch) = (self.run * of_input, self.tap_pitch * of_input);
        let (steps, rest) = (run / ROW_BYTES, run % ROW_BYTES);
        let pitch = self.vectors * ROW_BYTES;
        // A row of weights has those of a group of inputs, which is four bytes.
        let (weight_rows, rest_rows) = (run / 4, rest / 4);
        let inputs = pixels.map(|x| {
            let input = self.input.wrapping_add(x * self.input_step);
            input.cast::<u8>()
        });
        let weights = self.panel.cast::<u8>().wrapping_add(first * ROW_BYTES);
        if steps > 0 && self.tap_rows > 0 {
            let operands = Operands {
                inputs,
                input_pitch: self.input_step * of_input,
                weights,
                weight_pitch: pitch,
                steps,
                runs: self.tap_rows,
                // Back, where rows of taps overlap.
                next_inputs: tap_pitch.wrapping_sub(steps * ROW_BYTES),
                next_weights: rest_rows * pitch,
            };
            multiply(&operands, sums);
        }
        if rest == 0 {
            return;
        }
        let mut copy = Rest {
            inputs: [[[0; ROW_BYTES]; ROWS]; 2],
            weights: [[[0; ROW_BYTES]; VECTORS]; ROWS],
        };
        for tap_row in 0..self.tap_rows {
            for (copy, input) in copy.inputs.iter_mut().zip(inputs) {
                for (row, copy) in copy.iter_mut().enumerate().take(shapes.rows()) {
                    let at = row * self.input_step * of_input + tap_row * tap_pitch;
                    let from = input.wrapping_add(at + steps * ROW_BYTES);
                    // SAFETY: as for this function: the end of a row of taps of a pixel.
                    unsafe { std::ptr::copy_nonoverlapping(from, copy.as_mut_ptr(), rest) };
                }
            }
            for (row, copy) in copy.weights.iter_mut().enumerate().take(rest_rows) {
                let row = tap_row * weight_rows + steps * ROWS + row;
                let from = weights.wrapping_add(row * pitch).cast::<[u8; ROW_BYTES]>();
                for (vector, copy) in copy.iter_mut().enumerate().take(width) {
                    // SAFETY: as for this function: a vector of the last groups of a row of taps.
                    *copy = unsafe { from.add(vector).read_unaligned() };
                }
            }
            let operands = Operands {
                inputs: [0, 1].map(|part| copy.inputs[part].as_ptr().cast()),
                input_pitch: ROW_BYTES,
                weights: copy.weights.as_ptr().cast(),
                weight_pitch: VECTORS * ROW_BYTES,
                steps: 1,
                runs: 1,
                next_inputs: 0,
                next_weights: 0,
            };
            multiply(&operands, sums);
        }
    }
}
