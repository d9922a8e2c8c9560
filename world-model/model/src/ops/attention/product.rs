//! Products of small row-major matrices that stay in cache.

#[cfg(target_arch = "aarch64")]
use crate::ops::simd::Neon;
#[cfg(target_arch = "x86_64")]
use crate::ops::simd::{Avx2, Avx512};
use crate::ops::simd::{InstructionSet, Lanes, Portable};

/// Columns that the inner loop handles at once; the products' widths are multiples of it.
pub(super) use crate::ops::simd::LANES;

/// The left factor of a product: element (row, k) lies at `row * row_step + k * step`, so that a transposed matrix needs
/// no copy.
#[derive(Clone, Copy)]
pub(super) struct Left<'a> {
    values: &'a [f32],
    row_step: usize,
    step: usize,
}

impl<'a> Left<'a> {
    /// Rows of `width` values.
    pub(super) fn rows(values: &'a [f32], width: usize) -> Self {
        Self {
            values,
            row_step: width,
            step: 1,
        }
    }

    /// The transpose of rows of `width` values.
    pub(super) fn transposed(values: &'a [f32], width: usize) -> Self {
        Self {
            values,
            row_step: 1,
            step: width,
        }
    }
}

/// `c` (m, n) = `a` (m, k) times `b` (k, n).
///
/// # Panics
/// If `n` is not a multiple of [`LANES`], or a slice is too short.
pub(super) fn product((m, k, n): (usize, usize, usize), a: Left<'_>, b: &[f32], c: &mut [f32]) {
    let last_of_a = m.saturating_sub(1) * a.row_step + k.saturating_sub(1) * a.step;
    assert!(
        m == 0 || k == 0 || last_of_a < a.values.len(),
        "left factor"
    );
    assert!(n.is_multiple_of(LANES) && k * n <= b.len(), "right factor");
    assert!(m * n <= c.len(), "product");
    let operands = Operands {
        a: a.values.as_ptr(),
        row_step: a.row_step,
        step: a.step,
        b: b.as_ptr(),
        c: c.as_mut_ptr(),
        m,
        k,
        n,
    };
    match InstructionSet::detect() {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the lengths were checked above, and the processor was found to have these instructions.
        InstructionSet::Avx512 => unsafe { operands.avx512() },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        InstructionSet::Avx2 => unsafe { operands.avx2() },
        #[cfg(target_arch = "aarch64")]
        // SAFETY: as above. Its thirty-two registers have four lanes.
        InstructionSet::Neon => unsafe { operands.tiles::<Neon, 6>() },
        // SAFETY: as above.
        InstructionSet::Portable => unsafe { operands.tiles::<Portable, 4>() },
    }
}

/// A product whose operands were found to be long enough.
struct Operands {
    a: *const f32,
    row_step: usize,
    step: usize,
    b: *const f32,
    c: *mut f32,
    m: usize,
    k: usize,
    n: usize,
}

impl Operands {
    /// With thirty-two registers of sixteen lanes.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f")]
    unsafe fn avx512(&self) {
        // SAFETY: the caller vouches for the operands.
        unsafe { self.tiles::<Avx512, 12>() }
    }

    /// With sixteen registers of eight lanes.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn avx2(&self) {
        // SAFETY: as above.
        unsafe { self.tiles::<Avx2, 6>() }
    }

    /// In tiles of at most `MOST` rows, as equal as can be: a tile of a single row takes nearly as long as one of four.
    #[inline(always)]
    unsafe fn tiles<L: Lanes, const MOST: usize>(&self) {
        let tiles = self.m.div_ceil(MOST);
        for tile in 0..tiles {
            let (first, end) = (self.m * tile / tiles, self.m * (tile + 1) / tiles);
            // SAFETY: as above; the rows exist.
            unsafe {
                match end - first {
                    1 => self.tile::<L, 1>(first),
                    2 => self.tile::<L, 2>(first),
                    3 => self.tile::<L, 3>(first),
                    4 if MOST > 4 => self.tile::<L, 4>(first),
                    5 if MOST > 5 => self.tile::<L, 5>(first),
                    6 if MOST > 6 => self.tile::<L, 6>(first),
                    7 if MOST > 7 => self.tile::<L, 7>(first),
                    8 if MOST > 8 => self.tile::<L, 8>(first),
                    9 if MOST > 9 => self.tile::<L, 9>(first),
                    10 if MOST > 10 => self.tile::<L, 10>(first),
                    11 if MOST > 11 => self.tile::<L, 11>(first),
                    _ => self.tile::<L, MOST>(first),
                }
            }
        }
    }

    #[inline(always)]
    unsafe fn tile<L: Lanes, const ROWS: usize>(&self, first: usize) {
        // SAFETY: as above; `first + ROWS` rows exist.
        unsafe {
            let (a, c) = (
                self.a.add(first * self.row_step),
                self.c.add(first * self.n),
            );
            for column in (0..self.n).step_by(LANES) {
                let mut sums = [L::splat(0.0); ROWS];
                for k in 0..self.k {
                    let b = L::load(self.b.add(k * self.n + column));
                    let a = a.add(k * self.step);
                    for (row, sum) in sums.iter_mut().enumerate() {
                        *sum = L::splat(*a.add(row * self.row_step)).mul_add(b, *sum);
                    }
                }
                for (row, sum) in sums.iter().enumerate() {
                    sum.store(c.add(row * self.n + column));
                }
            }
        }
    }
}

/// Rows that a transposition takes at once: as many values lie side by side in its result.
const BLOCK: usize = 8;

/// `out` (columns, out_width) = the transpose of `a` (rows, columns), for rows <= out_width.
#[inline(always)]
pub(super) fn transpose(columns: usize, a: &[f32], out_width: usize, out: &mut [f32]) {
    let blocks = a.chunks_exact(BLOCK * columns);
    let (rest, done) = (blocks.remainder(), blocks.len() * BLOCK);
    for (block, rows) in blocks.enumerate() {
        let rows: [&[f32]; BLOCK] = std::array::from_fn(|row| &rows[row * columns..][..columns]);
        for (column, out) in out.chunks_exact_mut(out_width).take(columns).enumerate() {
            let values: [f32; BLOCK] = std::array::from_fn(|row| rows[row][column]);
            out[block * BLOCK..][..BLOCK].copy_from_slice(&values);
        }
    }
    for (row, a) in rest.chunks_exact(columns).enumerate() {
        for (column, value) in a.iter().enumerate() {
            out[column * out_width + done + row] = *value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Small integers, so that sums are exact.
    fn matrix(len: usize, seed: usize) -> Vec<f32> {
        (0..len)
            .map(|i| ((i * 7 + seed) % 11) as f32 - 5.0)
            .collect()
    }

    #[test]
    fn products_are_those_of_the_definition() {
        for m in 0..=27 {
            check(m, 32, 17);
        }
    }

    fn check(m: usize, n: usize, k: usize) {
        let (a, b) = (matrix(m * k, 1), matrix(k * n, 2));
        let mut expected = vec![0.0; m * n];
        for row in 0..m {
            for column in 0..n {
                expected[row * n + column] =
                    (0..k).map(|i| a[row * k + i] * b[i * n + column]).sum();
            }
        }
        let mut c = vec![1.0; m * n];
        product((m, k, n), Left::rows(&a, k), &b, &mut c);
        assert_eq!(c, expected);

        // What lies beside the transposed rows is no part of them.
        let width = m + 3;
        let mut transposed = vec![f32::NAN; k * width];
        transpose(k, &a, width, &mut transposed);
        let mut c = vec![1.0; m * n];
        product((m, k, n), Left::transposed(&transposed, width), &b, &mut c);
        assert_eq!(c, expected, "transposed");

        let mut back = vec![0.0; width * k];
        transpose(width, &transposed, k, &mut back);
        assert_eq!(back[..m * k], a);
    }

    #[test]
    #[should_panic(expected = "left factor")]
    fn a_factor_that_is_too_short_is_refused() {
        product(
            (3, 4, 16),
            Left::rows(&[0.0; 11], 4),
            &[0.0; 64],
            &mut [0.0; 48],
        );
    }
}
