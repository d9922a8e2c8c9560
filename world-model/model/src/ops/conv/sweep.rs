//! One pass of a kernel over all output pixels.

use rayon::prelude::*;

use super::GridSize;
use super::band::{Band, BandBuffer, Banded};
use super::taps::Taps;
use super::target::Target;
use super::tile::{Rectangle, Tile};
use crate::ops::element::Element;
use crate::ops::group_norm::Normalisation;
use crate::ops::kernel::{Prefetch, Product, Row};
use crate::ops::panels::Panels;
use crate::ops::simd::{LANES, NO_BIAS};

/// Bytes of weights that are used for a whole tile before the next ones are read: few enough to stay in a second-level
/// cache beside the tile's inputs. A panel of a wide layer is larger than that cache.
const WEIGHT_BYTES: usize = 128 * 1024;

/// A convolution in the form that the kernel runs.
pub(super) struct Sweep<'a, P: Product> {
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
    /// Weights, for [`whole_channels`] of every tap.
    pub panels: &'a Panels<P::Weight>,
    /// What computes the products.
    pub unit: P::Unit,
    /// What is done to each image of the input first.
    pub normalisations: Option<&'a [Normalisation]>,
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

/// Channels of a pixel that products of `T` take: whole groups.
pub(super) fn whole_channels<T: Element>(channels: usize) -> usize {
    channels.next_multiple_of(T::GROUP)
}

impl<P: Product<Scales = ()>> Sweep<'_, P>
where
    P::Input: Banded,
{
    /// Writes the elements `out` of `output`; residual and mask must be as long as `output`.
    pub(super) fn run(&self, out: Output, output: &mut [f32]) {
        // SAFETY: a slice is valid for its length.
        unsafe { self.run_at(out, output.as_mut_ptr(), output.len()) }
    }

    /// As [`Self::run`], to `length` values at `output` that need not be initialised.
    ///
    /// # Safety
    /// `length` values must be writable at `output`.
    pub(super) unsafe fn run_at(&self, out: Output, output: *mut f32, length: usize) {
        if out.height == 0 || out.width == 0 || self.grid.images == 0 {
            return;
        }
        let last = out.start
            + (self.grid.images - 1) * out.image_step
            + (out.height - 1) * out.row_step
            + (out.width - 1) * out.pixel_step
            + self.panels.outputs;
        let channels = whole_channels::<P::Weight>(self.channels);
        // The kernel trusts these; they hold by construction in this module's callers.
        assert!(last <= length, "output too short for the sweep");
        assert!(self.residual.is_none_or(|r| r.len() == length));
        assert!(self.mask.is_none_or(|m| m.len() == length));
        assert_eq!(self.panels.depth, self.taps.0 * self.taps.1 * channels);

        let pixel = channels * size_of::<P::Input>();
        let tile = Tile::new((out.height, out.width), self.taps, self.stride, pixel)
            .for_images(self.grid.images, out.height);
        let tiles = tile.count(out.height, out.width);
        let target = Target(output);
        (0..self.grid.images * tiles)
            .into_par_iter()
            .for_each(|task| {
                let part = tile.part(task % tiles, out.height, out.width);
                P::Input::with_buffer(|buffer| {
                    self.tile(task / tiles, part, out, target, buffer);
                });
            });
    }

    /// Computes the rectangle `part` of an image's outputs.
    fn tile(
        &self,
        image: usize,
        part: Rectangle,
        out: Output,
        target: Target,
        buffer: &mut BandBuffer<P::Input>,
    ) {
        let size = self.grid.height * self.grid.width * self.channels;
        let Some(source) = self.input.get(image * size..(image + 1) * size) else {
            return;
        };
        let channels = whole_channels::<P::Weight>(self.channels);
        let reach = |outputs: usize, taps: usize| ((outputs - 1) * self.stride + taps).max(1);
        let columns = reach(part.width, self.taps.1);
        let origin = |first: usize, pad: isize| (first * self.stride) as isize - pad;
        let band = Band {
            image: (self.grid.height, self.grid.width, self.channels),
            origin: (origin(part.top, self.pad.0), origin(part.left, self.pad.1)),
            size: (reach(part.height, self.taps.0), columns),
            channels,
        };
        let normalisation = self.normalisations.and_then(|all| all.get(image));
        band.copy(source, normalisation, buffer);

        let pitch = columns * channels;
        let run = self.taps.1 * channels;
        let start = out.start
            + image * out.image_step
            + part.top * out.row_step
            + part.left * out.pixel_step;
        for (vectors, panel, channel) in self.panels.iter() {
            let most = (WEIGHT_BYTES / (vectors * LANES * size_of::<P::Weight>())).max(1);
            let parts = Taps::all((self.taps.0, run), most, P::Weight::GROUP);
            for (number, taps) in parts.iter().enumerate() {
                let (is_first, is_last) = (number == 0, number + 1 == parts.len());
                for row in 0..part.height {
                    let at = start + row * out.row_step + channel;
                    let same = |slice: Option<&[f32]>| {
                        slice.map_or(std::ptr::null(), |s| s.as_ptr().wrapping_add(at))
                    };
                    let input = (row * self.stride + taps.tap_row) * pitch + taps.start;
                    let weights = (taps.tap_row * run + taps.start) * vectors * LANES;
                    let kernel = Row::<P> {
                        input: buffer.values.as_ptr().wrapping_add(input),
                        input_step: self.stride * channels,
                        tap_pitch: pitch,
                        tap_rows: taps.tap_rows,
                        run: taps.run,
                        panel: self.panels.values.as_ptr().wrapping_add(panel + weights),
                        vectors,
                        bias: if is_first {
                            self.panels.bias.as_ptr().wrapping_add(channel)
                        } else {
                            NO_BIAS.as_ptr()
                        },
                        scales: (),
                        pixels: part.width,
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
                        accumulates: false,
                        prefetch: Prefetch::NOTHING,
                    };
                    // SAFETY: the band has a row of taps for each output row and `columns` pixels in each; the
                    // panels have `depth` rows, of which the parts are disjoint; `run_at` checked the output's
                    // length, and residual and mask are as long; no other task writes this rectangle; the panels
                    // were cut for what the processor was found to have, and no panel is wider than `NO_BIAS`.
                    unsafe { kernel.run(self.unit) };
                }
            }
        }
    }
}
