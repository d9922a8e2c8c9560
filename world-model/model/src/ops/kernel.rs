//! The two inner loops of convolutions and matrix products.
//!
//! Both keep a tile of results in registers: [`Row`] sums over taps and input channels (a matrix
//! product is a convolution with one tap, its rows the pixels), and [`Outer`] sums over pixels for
//! the gradient of the weights. A [`Row`] is computed in the number formats of a [`Product`].

use super::element::Element;
use super::simd::{LANES, Lanes, Portable};

#[cfg(target_arch = "x86_64")]
mod amx;
mod outer;
mod prefetch;

pub(crate) use outer::Outer;
pub(crate) use prefetch::{Prefetch, l2_cache_size};

/// Groups of inputs that are multiplied between two prefetches.
const GROUPS_PER_PREFETCH: usize = 8;

/// The number formats of a product.
///
/// One step takes a group of neighbouring inputs, and for each output as many weights, which lie side by side
/// ([`Element::GROUP`]).
pub(crate) trait Product: Copy + Send + Sync + 'static {
    /// The format of the inputs.
    type Input: Element;
    /// The format of the weights.
    type Weight: Element;
    /// The instructions that compute it.
    type Unit: Copy + Send + Sync;
    /// The factors from sums to outputs; empty if the sums are the outputs.
    type Scales: Scales;
    /// Whether the sums are outputs.
    const SUMS_ARE_OUTPUTS: bool = size_of::<Self::Scales>() == 0;

    /// Computes a row.
    ///
    /// # Safety
    /// All pointers of `row` must be valid for what their comments say, and the processor must have `unit`.
    unsafe fn run(row: &Row<Self>, unit: Self::Unit);
}

/// What makes outputs of the sums of a row.
pub(crate) trait Scales: Copy {
    /// Where the sums start, for every output: at the `bias`, or at numbers of as many bits if the sums are not f32.
    fn starts(&self, bias: *const f32) -> *const f32;

    /// The outputs of the sums of a vector of a pixel; `place` is (pixel, vector).
    ///
    /// # Safety
    /// The row has that pixel and that vector, and `bias` and scales are its.
    unsafe fn outputs<L: Lanes>(&self, bias: *const f32, place: (usize, usize), sums: L) -> L;
}

/// The sums are outputs.
impl Scales for () {
    #[inline(always)]
    fn starts(&self, bias: *const f32) -> *const f32 {
        bias
    }

    #[inline(always)]
    unsafe fn outputs<L: Lanes>(&self, _: *const f32, _: (usize, usize), sums: L) -> L {
        sums
    }
}

/// A step of a product on the lanes `L`, of which each holds a group or a sum.
///
/// The methods must be called only where the instruction set of `L` is enabled.
pub(crate) trait Step<L: Lanes>: Product {
    /// A group of inputs, in all lanes.
    ///
    /// # Safety
    /// A group must be readable at `input`.
    unsafe fn splat(input: *const Self::Input) -> L;

    /// The groups of weights of [`LANES`] outputs.
    ///
    /// # Safety
    /// As many groups must be readable at `weights`.
    unsafe fn load(weights: *const Self::Weight) -> L;

    /// `sums` plus the products of inputs and weights.
    fn add(inputs: L, weights: L, sums: L) -> L;
}

/// One row of output pixels, for one panel of output channels.
#[derive(Clone, Copy)]
pub(crate) struct Row<P: Product> {
    /// Input of the first pixel's first tap.
    pub input: *const P::Input,
    /// From one output pixel's input to the next's.
    pub input_step: usize,
    /// From one row of taps to the next.
    pub tap_pitch: usize,
    /// Rows of taps.
    pub tap_rows: usize,
    /// Contiguous inputs (taps times channels) in a row of taps: whole groups.
    pub run: usize,
    /// Weights, `tap_rows * run` rows of `vectors * LANES`, those of a group side by side.
    pub panel: *const P::Weight,
    /// Vectors of output channels in the panel.
    pub vectors: usize,
    /// Bias, `vectors * LANES` values.
    pub bias: *const f32,
    /// Whether the sums start at the outputs instead of the bias, to add further inputs. Such a panel has no padding.
    pub accumulates: bool,
    /// What else makes outputs of sums.
    pub scales: P::Scales,
    /// Pixels.
    pub pixels: usize,
    /// Output of the first pixel.
    pub output: *mut f32,
    /// Added to the sum; laid out as the output, and may be the output. May be null.
    pub residual: *const f32,
    /// Where it is not positive the output is zero; laid out as the output. May be null.
    pub mask: *const f32,
    /// From one output pixel to the next.
    pub output_step: usize,
    /// Channels of the panel that exist; the rest of the last vector is padding.
    pub channels: usize,
    /// Whether negative outputs become zero.
    pub relu: bool,
    /// The weights of the next row.
    pub prefetch: Prefetch,
}

impl<P: Product> Row<P> {
    /// Computes it.
    ///
    /// # Safety
    /// All pointers must be valid for what their comments say, and the processor must have `unit`.
    pub(crate) unsafe fn run(&self, unit: P::Unit) {
        // SAFETY: as for this function.
        unsafe { P::run(self, unit) }
    }

    /// With thirty-two registers of sixteen lanes.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub(super) unsafe fn wide_tiles<L: Lanes>(&self)
    where
        P: Step<L>,
    {
        // SAFETY: as for `run`.
        unsafe {
            match self.vectors {
                1 => self.tiles::<L, 16, 1>(),
                2 => self.tiles::<L, 8, 2>(),
                3 => self.tiles::<L, 8, 3>(),
                _ => self.tiles::<L, 6, 4>(),
            }
        }
    }

    #[inline(always)]
    pub(super) unsafe fn tiles<L: Lanes, const M: usize, const N: usize>(&self)
    where
        P: Step<L>,
    {
        debug_assert_eq!(self.vectors, N);
        let steps = (self.run / P::Weight::GROUP).div_ceil(GROUPS_PER_PREFETCH) * self.tap_rows;
        let mut prefetch = self.prefetch.in_parts(self.pixels.div_ceil(M) * steps);
        // SAFETY: as for `run`; every tile lies within the row.
        unsafe {
            // No tile overlaps another, so that the residual may be the output itself.
            let mut x = 0;
            for _ in 0..whole_tiles(self.pixels, M) {
                self.tile::<L, M, N>(x, &mut prefetch);
                x += M;
            }
            while x + 4 <= self.pixels {
                self.tile::<L, 4, N>(x, &mut prefetch);
                x += 4;
            }
            while x < self.pixels {
                self.tile::<L, 1, N>(x, &mut prefetch);
                x += 1;
            }
        }
    }

    #[inline(always)]
    unsafe fn tile<L: Lanes, const M: usize, const N: usize>(
        &self,
        x: usize,
        prefetch: &mut Prefetch,
    ) where
        P: Step<L>,
    {
        // SAFETY: as for `run`; `x + M` pixels exist.
        unsafe {
            let mut sums = [[L::splat(0.0); N]; M];
            let starts = self.scales.starts(self.bias);
            let so_far = self.output.add(x * self.output_step).cast_const();
            for (i, sum) in sums.iter_mut().enumerate() {
                for (j, sum) in sum.iter_mut().enumerate() {
                    let start = match self.accumulates {
                        true => so_far.add(i * self.output_step),
                        false => starts,
                    };
                    *sum = L::load(start.add(j * LANES));
                }
            }
            let mut weights = self.panel;
            let step = self.input_step;
            for tap_row in 0..self.tap_rows {
                let first = self.input.add(x * step + tap_row * self.tap_pitch);
                // A pointer to each pixel's inputs: otherwise the compiler adds the step between pixels in the loop below, and
                // loads it from memory each time.
                let mut inputs = [first; M];
                for (i, input) in inputs.iter_mut().enumerate() {
                    *input = first.add(i * step);
                }
                let groups = self.run / P::Weight::GROUP;
                let together = if prefetch.is_done() {
                    groups
                } else {
                    GROUPS_PER_PREFETCH
                };
                let mut group = 0;
                while group < groups {
                    // The caller vouches for the weights of the next row as for those of this one.
                    prefetch.next_part();
                    let end = groups.min(group + together);
                    while group < end {
                        let mut w = [L::splat(0.0); N];
                        for (j, w) in w.iter_mut().enumerate() {
                            *w = P::load(weights.add(j * LANES * P::Weight::GROUP));
                        }
                        weights = weights.add(N * LANES * P::Weight::GROUP);
                        for (sum, input) in sums.iter_mut().zip(inputs) {
                            let a = P::splat(input.add(group * P::Weight::GROUP));
                            for (sum, w) in sum.iter_mut().zip(w) {
                                *sum = P::add(a, w, *sum);
                            }
                        }
                        group += 1;
                    }
                }
            }
            let is_plain = self.mask.is_null() && !self.relu && self.channels >= N * LANES;
            let write = |(i, j): (usize, usize), outputs: L| {
                let at = (x + i) * self.output_step + j * LANES;
                let outputs = if self.residual.is_null() {
                    outputs
                } else {
                    outputs.add(L::load(self.residual.add(at)))
                };
                outputs.store(self.output.add(at));
            };
            if is_plain && P::SUMS_ARE_OUTPUTS {
                for (i, sums) in sums.iter().enumerate() {
                    for (j, sum) in sums.iter().enumerate() {
                        write((i, j), *sum);
                    }
                }
                return;
            }
            // By way of memory, in two loops: what indexes `sums` must be small enough to be
            // unrolled, or the compiler keeps the sums in memory in the loop above as well.
            let mut values = [[[0.0f32; LANES]; N]; M];
            for (sums, values) in sums.iter().zip(&mut values) {
                for (sum, values) in sums.iter().zip(values) {
                    sum.store(values.as_mut_ptr());
                }
            }
            if is_plain {
                for (i, values) in values.iter().enumerate() {
                    for (j, values) in values.iter().enumerate() {
                        let sums = L::load(values.as_ptr());
                        write((i, j), self.scales.outputs(self.bias, (x + i, j), sums));
                    }
                }
                return;
            }
            for (i, values) in values.iter_mut().enumerate() {
                for (j, values) in values.iter_mut().enumerate() {
                    self.finish(x + i, j, values);
                }
            }
        }
    }

    /// Makes the outputs of vector `vector` of pixel `x` of their sums.
    #[inline(always)]
    unsafe fn finish(&self, x: usize, vector: usize, values: &mut [f32; LANES]) {
        // SAFETY: as for `run`; the pixel exists, and no channel beyond `channels` is touched.
        unsafe {
            let outputs = Portable::load(values.as_ptr());
            let outputs = self.scales.outputs(self.bias, (x, vector), outputs);
            outputs.store(values.as_mut_ptr());
            let at = x * self.output_step + vector * LANES;
            let count = (self.channels - vector * LANES).min(LANES);
            if !self.residual.is_null() {
                let residual = self.residual.add(at);
                if count == LANES {
                    let residual = residual.cast::<[f32; LANES]>().read_unaligned();
                    for (v, r) in values.iter_mut().zip(residual) {
                        *v += r;
                    }
                } else {
                    for (c, v) in values.iter_mut().enumerate().take(count) {
                        *v += *residual.add(c);
                    }
                }
            }
            if self.relu {
                for v in values.iter_mut() {
                    *v = v.max(0.0);
                }
            }
            if !self.mask.is_null() {
                let mask = self.mask.add(at);
                if count == LANES {
                    let mask = mask.cast::<[f32; LANES]>().read_unaligned();
                    for (v, m) in values.iter_mut().zip(mask) {
                        *v = if m > 0.0 { *v } else { 0.0 };
                    }
                } else {
                    for (c, v) in values.iter_mut().enumerate().take(count) {
                        *v = if *mask.add(c) > 0.0 { *v } else { 0.0 };
                    }
                }
            }
            let output = self.output.add(at);
            if count == LANES {
                output.cast::<[f32; LANES]>().write_unaligned(*values);
            } else {
                std::ptr::copy_nonoverlapping(values.as_ptr(), output, count);
            }
        }
    }
}

/// How many tiles of `most` pixels a row is to have if the rest is cut into tiles of four and single pixels: a single one
/// takes nearly as long as four, so that of 32 pixels four sixes and two fours beat five sixes and two single ones.
fn whole_tiles(pixels: usize, most: usize) -> usize {
    let all = pixels / most;
    let best = (all.saturating_sub(2)..=all)
        .rev()
        .min_by_key(|tiles| (pixels - tiles * most) % 4);
    best.unwrap_or(all)
}

#[cfg(test)]
mod tests;
