//! One pass of a kernel over all output pixels.

use std::cell::RefCell;

use rayon::prelude::*;

use super::GridSize;
use super::band::Band;
use crate::ops::kernel::Row;
use crate::ops::panels::Panels;
use crate::ops::simd::{LANES, NO_BIAS};

thread_local! {
    /// Band of input rows that the thread works on.
    static BAND: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// Bytes that a band should have at most, so that it stays in a second-level cache.
const BAND_BYTES: usize = 192 * 1024;

/// Bytes of weights that are used for a whole band before the next ones are read: few enough to stay in a second-level
/// cache beside the band. A panel of a wide layer is larger than that cache.
const WEIGHT_BYTES: usize = 128 * 1024;

/// A convolution in the form that the kernel runs.
pub(super) struct Sweep<'a> {
    /// Input activations.
    pub input: &'a [f32],
    /// Size of the input in memory.
    pub grid: GridSize,
    /// Channels of the input.
    pub channels: usize,
    /// Rows and columns of taps.
    pub taps: (usize, usize),
    /// Input pixels from one output to the next.
    pub stride: usize,
    /// How far the first tap lies before the output's own place: rows, columns.
    pub pad: (isize, isize),
    /// Weights.
    pub panels: &'a Panels,
    /// Added to the sums, laid out as the output.
    pub residual: Option<&'a [f32]>,
    /// The output is zero where this is not positive; laid out as the output.
    pub mask: Option<&'a [f32]>,
    /// Whether negative outputs become zero.
    pub relu: bool,
}

/// Which elements of the output a sweep writes.
#[derive(Clone, Copy)]
pub(super) struct Output {
    /// Rows and columns that it writes in each image.
    pub height: usize,
    pub width: usize,
    /// The first element.
    pub start: usize,
    /// From one pixel, row and image to the next.
    pub pixel_step: usize,
    pub row_step: usize,
    pub image_step: usize,
}

#[derive(Clone, Copy)]
struct Target(*mut f32);

// SAFETY: the tasks that share the pointer write to disjoint rows.
unsafe impl Send for Target {}
// SAFETY: as above.
unsafe impl Sync for Target {}

impl Target {
    /// A method, so that closures capture the whole wrapper.
    fn at(self, offset: usize) -> *mut f32 {
        self.0.wrapping_add(offset)
    }
}

impl Sweep<'_> {
    /// Writes the elements `out` of `output`; residual and mask must be as long as `output`.
    pub(super) fn run(&self, out: Output, output: &mut [f32]) {
        if out.height == 0 || out.width == 0 || self.grid.images == 0 {
            return;
        }
        let last = out.start
            + (self.grid.images - 1) * out.image_step
            + (out.height - 1) * out.row_step
            + (out.width - 1) * out.pixel_step
            + self.panels.outputs;
        let (tap_rows, tap_columns) = self.taps;
        // The kernel trusts these; they hold by construction in this module's callers.
        assert!(last <= output.len(), "output too short for the sweep");
        assert!(self.residual.is_none_or(|r| r.len() == output.len()));
        assert!(self.mask.is_none_or(|m| m.len() == output.len()));
        assert_eq!(self.panels.depth, tap_rows * tap_columns * self.channels);

        let columns = ((out.width - 1) * self.stride + tap_columns).max(1);
        let row_bytes = columns * self.channels * self.stride * size_of::<f32>();
        let rows = (BAND_BYTES / row_bytes.max(1))
            .min(
                out.height
                    .div_ceil(if self.grid.images < 4 { 4 } else { 1 }),
            )
            .max(1);
        let bands = out.height.div_ceil(rows);
        let target = Target(output.as_mut_ptr());
        (0..self.grid.images * bands)
            .into_par_iter()
            .for_each(|task| {
                let (image, band) = (task / bands, task % bands);
                let first = band * rows;
                let count = rows.min(out.height - first);
                BAND.with_borrow_mut(|buffer| {
                    self.band(image, first, (count, columns), out, target, buffer);
                });
            });
    }

    fn band(
        &self,
        image: usize,
        first: usize,
        (count, columns): (usize, usize),
        out: Output,
        target: Target,
        buffer: &mut Vec<f32>,
    ) {
        let (tap_rows, tap_columns) = self.taps;
        let size = self.grid.height * self.grid.width * self.channels;
        let Some(source) = self.input.get(image * size..(image + 1) * size) else {
            return;
        };
        let band = Band {
            image: (self.grid.height, self.grid.width, self.channels),
            origin: ((first * self.stride) as isize - self.pad.0, -self.pad.1),
            size: (((count - 1) * self.stride + tap_rows).max(1), columns),
        };
        band.copy(source, buffer);
        let pitch = columns * self.channels;
        let start = out.start + image * out.image_step;
        let run = tap_columns * self.channels;
        for (vectors, panel, channel) in self.panels.iter() {
            let most = (WEIGHT_BYTES / (vectors * LANES * size_of::<f32>())).max(1);
            let parts = Part::all((tap_rows, run), most);
            for (number, part) in parts.iter().enumerate() {
                let (is_first, is_last) = (number == 0, number + 1 == parts.len());
                for row in 0..count {
                    let at = start + (first + row) * out.row_step + channel;
                    let same = |slice: Option<&[f32]>| {
                        slice.map_or(std::ptr::null(), |s| s.as_ptr().wrapping_add(at))
                    };
                    let input = (row * self.stride + part.tap_row) * pitch + part.start;
                    let weights = (part.tap_row * run + part.start) * vectors * LANES;
                    let kernel = Row {
                        input: buffer.as_ptr().wrapping_add(input),
                        input_step: self.stride * self.channels,
                        tap_pitch: pitch,
                        tap_rows: part.tap_rows,
                        run: part.run,
                        panel: self.panels.values.as_ptr().wrapping_add(panel + weights),
                        vectors,
                        bias: if is_first {
                            self.panels.bias.as_ptr().wrapping_add(channel)
                        } else {
                            NO_BIAS.as_ptr()
                        },
                        pixels: out.width,
                        output: target.at(at),
                        residual: if is_first {
                            same(self.residual)
                        } else {
                            target.at(at).cast_const()
                        },
                        mask: if is_last {
                            same(self.mask)
                        } else {
                            std::ptr::null()
                        },
                        output_step: out.pixel_step,
                        channels: (self.panels.outputs - channel).min(vectors * LANES),
                        relu: self.relu && is_last,
                    };
                    // SAFETY: the band buffer has a row of taps for each output row and `columns`
                    // pixels in each; the panels have `depth` rows, of which the parts are disjoint;
                    // `run` checked the output's length, and residual and mask are as long; no other
                    // task writes these rows; the panels were cut for an instruction set that was
                    // detected, and no panel is wider than `NO_BIAS`.
                    unsafe { kernel.run(self.panels.set) };
                }
            }
        }
    }
}

/// Taps and channels that are summed before the next ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Part {
    /// The first row of taps, and how many.
    tap_row: usize,
    tap_rows: usize,
    /// The first value in a row of taps, and how many.
    start: usize,
    run: usize,
}

impl Part {
    /// Cuts `tap_rows` rows of `run` values into parts of about `most` values: whole rows of taps, or pieces of one.
    fn all((tap_rows, run): (usize, usize), most: usize) -> Vec<Self> {
        if tap_rows * run <= most {
            return vec![Self {
                tap_row: 0,
                tap_rows,
                start: 0,
                run,
            }];
        }
        let pieces = run.div_ceil(most);
        let rows = (0..tap_rows).flat_map(|tap_row| {
            (0..pieces).map(move |i| {
                let (start, end) = (run * i / pieces, run * (i + 1) / pieces);
                Self {
                    tap_row,
                    tap_rows: 1,
                    start,
                    run: end - start,
                }
            })
        });
        rows.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_cover_every_tap_and_channel_once() {
        for (taps, most) in [((3, 9), 27), ((3, 9), 26), ((3, 9), 4), ((1, 5), 2)] {
            let mut seen = vec![0; taps.0 * taps.1];
            for part in Part::all(taps, most) {
                for row in part.tap_row..part.tap_row + part.tap_rows {
                    for at in part.start..part.start + part.run {
                        seen[row * taps.1 + at] += 1;
                    }
                }
            }
            assert!(seen.iter().all(|count| *count == 1), "{taps:?} {most}");
        }
    }
}
