//! Products of small row-major matrices that stay in cache.

/// Columns that the inner loop handles at once; the products' widths are multiples of it.
pub(super) const LANES: usize = 16;

/// Rows that the inner loop handles at once: with 16 lanes, eight accumulators hide the latency
/// of the multiply-adds.
const ROWS: usize = 8;

/// `c` (m, n) = the first k columns of `a` (m, a_width) times `b` (k, n).
#[inline(always)]
pub(super) fn product(n: usize, k: usize, a: &[f32], a_width: usize, b: &[f32], c: &mut [f32]) {
    let mut a_blocks = a.chunks_exact(ROWS * a_width);
    let mut c_blocks = c.chunks_exact_mut(ROWS * n);
    for (a, c) in a_blocks.by_ref().zip(c_blocks.by_ref()) {
        rows::<ROWS>(n, k, a, a_width, b, c);
    }
    let c_rest = c_blocks.into_remainder();
    for (a, c) in a_blocks
        .remainder()
        .chunks_exact(a_width)
        .zip(c_rest.chunks_exact_mut(n))
    {
        rows::<1>(n, k, a, a_width, b, c);
    }
}

#[inline(always)]
fn rows<const R: usize>(n: usize, k: usize, a: &[f32], a_width: usize, b: &[f32], c: &mut [f32]) {
    let a: [&[f32]; R] = std::array::from_fn(|r| &a[r * a_width..][..k]);
    for column in (0..n).step_by(LANES) {
        let mut sums = [[0.0_f32; LANES]; R];
        for i in 0..k {
            let b = &b[i * n + column..][..LANES];
            for r in 0..R {
                let a = a[r][i];
                for lane in 0..LANES {
                    sums[r][lane] = a.mul_add(b[lane], sums[r][lane]);
                }
            }
        }
        for (r, sums) in sums.iter().enumerate() {
            c[r * n + column..][..LANES].copy_from_slice(sums);
        }
    }
}

/// `out` (columns, out_width) = the transpose of `a` (rows, columns), for rows <= out_width.
#[inline(always)]
pub(super) fn transpose(columns: usize, a: &[f32], out_width: usize, out: &mut [f32]) {
    for (row, a) in a.chunks_exact(columns).enumerate() {
        for (column, value) in a.iter().enumerate() {
            out[column * out_width + row] = *value;
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
        let (m, n, k) = (19, 32, 17);
        let (a, b) = (matrix(m * k, 1), matrix(k * n, 2));
        let mut expected = vec![0.0; m * n];
        for row in 0..m {
            for column in 0..n {
                expected[row * n + column] =
                    (0..k).map(|i| a[row * k + i] * b[i * n + column]).sum();
            }
        }
        let mut c = vec![0.0; m * n];
        product(n, k, &a, k, &b, &mut c);
        assert_eq!(c, expected);

        let mut transposed = vec![0.0; k * 20];
        transpose(k, &a, 20, &mut transposed);
        let mut back = vec![0.0; 20 * k];
        transpose(20, &transposed, k, &mut back);
        assert_eq!(back[..m * k], a);
    }
}
