//! The gradient of weights: sums of outer products.

#[cfg(target_arch = "aarch64")]
use crate::ops::simd::Neon;
#[cfg(target_arch = "x86_64")]
use crate::ops::simd::{Avx2, Avx512};
use crate::ops::simd::{InstructionSet, LANES, Lanes, Portable};

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
