//! The two inner loops of convolutions and matrix products.
//!
//! Both keep a tile of results in registers: [`Row`] sums over taps and input channels (a matrix
//! product is a convolution with one tap, its rows the pixels), and [`Outer`] sums over pixels for
//! the gradient of the weights.

use crate::ops::element::Element;
use crate::ops::product::{Product, Step};
#[cfg(target_arch = "aarch64")]
use crate::ops::simd::Neon;
#[cfg(target_arch = "x86_64")]
use crate::ops::simd::{Avx2, Avx512};
use crate::ops::simd::{InstructionSet, LANES, Lanes, Portable};

#[cfg(target_arch = "x86_64")]
mod amx;

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
        // SAFETY: as for `run`; every tile lies within the row.
        unsafe {
            // No tile overlaps another, so that the residual may be the output itself.
            let mut x = 0;
            for _ in 0..whole_tiles(self.pixels, M) {
                self.tile::<L, M, N>(x);
                x += M;
            }
            while x + 4 <= self.pixels {
                self.tile::<L, 4, N>(x);
                x += 4;
            }
            while x < self.pixels {
                self.tile::<L, 1, N>(x);
                x += 1;
            }
        }
    }

    #[inline(always)]
    unsafe fn tile<L: Lanes, const M: usize, const N: usize>(&self, x: usize)
    where
        P: Step<L>,
    {
        // SAFETY: as for `run`; `x + M` pixels exist.
        unsafe {
            let mut sums = [[L::splat(0.0); N]; M];
            for sum in &mut sums {
                for (j, sum) in sum.iter_mut().enumerate() {
                    *sum = L::load(P::starts(self).add(j * LANES));
                }
            }
            let mut weights = self.panel;
            let step = self.input_step;
            for tap_row in 0..self.tap_rows {
                let mut input = self.input.add(x * step + tap_row * self.tap_pitch);
                for _ in 0..self.run / P::Weight::GROUP {
                    let mut w = [L::splat(0.0); N];
                    for (j, w) in w.iter_mut().enumerate() {
                        *w = P::load(weights.add(j * LANES * P::Weight::GROUP));
                    }
                    weights = weights.add(N * LANES * P::Weight::GROUP);
                    for (i, sum) in sums.iter_mut().enumerate() {
                        let a = P::splat(input.add(i * step));
                        for (sum, w) in sum.iter_mut().zip(w) {
                            *sum = P::add(a, w, *sum);
                        }
                    }
                    input = input.add(P::Weight::GROUP);
                }
            }
            if self.is_plain() && self.channels >= N * LANES {
                let at = x * self.output_step;
                for (i, sums) in sums.iter().enumerate() {
                    for (j, sum) in sums.iter().enumerate() {
                        let at = at + i * self.output_step + j * LANES;
                        let sum = if self.residual.is_null() {
                            *sum
                        } else {
                            sum.add(L::load(self.residual.add(at)))
                        };
                        sum.store(self.output.add(at));
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
            for (i, values) in values.iter_mut().enumerate() {
                for (j, values) in values.iter_mut().enumerate() {
                    self.finish(x + i, j, values);
                }
            }
        }
    }

    /// Whether the sums are written as they are, but for the residual.
    #[inline(always)]
    fn is_plain(&self) -> bool {
        P::SUMS_ARE_OUTPUTS && self.mask.is_null() && !self.relu
    }

    /// Makes the outputs of vector `vector` of pixel `x` of their sums.
    #[inline(always)]
    unsafe fn finish(&self, x: usize, vector: usize, values: &mut [f32; LANES]) {
        // SAFETY: as for `run`; the pixel exists, and no channel beyond `channels` is touched.
        unsafe {
            P::outputs(self, x, vector, values);
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

/// Adds to a matrix, for each pixel, the outer product of a run of inputs and a panel of output
/// gradients.
#[derive(Clone, Copy)]
pub(crate) struct Outer {
    /// Input of the first pixel.
    pub input: *const f32,
    /// From one pixel's input to the next's.
    pub input_step: usize,
    /// From one row's input to the next's.
    pub input_pitch: usize,
    /// Contiguous inputs of a pixel: rows of the matrix.
    pub run: usize,
    /// Gradient of the first pixel, `vectors * LANES` values.
    pub gradient: *const f32,
    /// From one pixel's gradient to the next's.
    pub gradient_step: usize,
    /// From one row's gradient to the next's.
    pub gradient_pitch: usize,
    /// Vectors in the panel.
    pub vectors: usize,
    /// Pixels in a row.
    pub pixels: usize,
    /// Rows of pixels.
    pub rows: usize,
    /// The matrix, `run` rows of `vectors * LANES`.
    pub sums: *mut f32,
}

impl Outer {
    /// # Safety
    /// All pointers must be valid for what their comments say, and the processor must have `set`.
    pub(crate) unsafe fn run(&self, set: InstructionSet) {
        // SAFETY: the caller vouches for the pointers and the instruction set.
        unsafe {
            match set {
                #[cfg(target_arch = "x86_64")]
                InstructionSet::Avx512 => self.run_avx512(),
                #[cfg(target_arch = "x86_64")]
                InstructionSet::Avx2 => self.run_avx2(),
                #[cfg(target_arch = "aarch64")]
                InstructionSet::Neon => self.tiles::<Neon, 6, 1>(),
                InstructionSet::Portable => self.tiles::<Portable, 4, 1>(),
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f")]
    unsafe fn run_avx512(&self) {
        // SAFETY: as for `run`.
        unsafe {
            match self.vectors {
                1 => self.tiles::<Avx512, 16, 1>(),
                2 => self.tiles::<Avx512, 12, 2>(),
                3 => self.tiles::<Avx512, 8, 3>(),
                _ => self.tiles::<Avx512, 6, 4>(),
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn run_avx2(&self) {
        // SAFETY: as for `run`.
        unsafe { self.tiles::<Avx2, 6, 1>() }
    }

    #[inline(always)]
    unsafe fn tiles<L: Lanes, const M: usize, const N: usize>(&self) {
        debug_assert_eq!(self.vectors, N);
        // SAFETY: as for `run`; every tile lies within the run.
        unsafe {
            let mut at = 0;
            while at + M <= self.run {
                self.tile::<L, M, N>(at);
                at += M;
            }
            while at < self.run {
                self.tile::<L, 1, N>(at);
                at += 1;
            }
        }
    }

    #[inline(always)]
    unsafe fn tile<L: Lanes, const M: usize, const N: usize>(&self, at: usize) {
        // SAFETY: as for `run`; `at + M` rows of the matrix exist.
        unsafe {
            let target = self.sums.add(at * N * LANES);
            let mut sums = [[L::splat(0.0); N]; M];
            for (i, sum) in sums.iter_mut().enumerate() {
                for (j, sum) in sum.iter_mut().enumerate() {
                    *sum = L::load(target.add((i * N + j) * LANES));
                }
            }
            for row in 0..self.rows {
                let mut input = self.input.add(row * self.input_pitch + at);
                let mut gradient = self.gradient.add(row * self.gradient_pitch);
                for _ in 0..self.pixels {
                    let mut g = [L::splat(0.0); N];
                    for (j, g) in g.iter_mut().enumerate() {
                        *g = L::load(gradient.add(j * LANES));
                    }
                    for (i, sum) in sums.iter_mut().enumerate() {
                        let a = L::splat(*input.add(i));
                        for (sum, g) in sum.iter_mut().zip(g) {
                            *sum = a.mul_add(g, *sum);
                        }
                    }
                    input = input.add(self.input_step);
                    gradient = gradient.add(self.gradient_step);
                }
            }
            for (i, sum) in sums.iter().enumerate() {
                for (j, sum) in sum.iter().enumerate() {
                    sum.store(target.add((i * N + j) * LANES));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
