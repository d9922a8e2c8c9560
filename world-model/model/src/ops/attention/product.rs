//! Products of small row-major matrices that stay in cache.

/// Columns that the inner loop handles at once; the products' widths are multiples of it.
pub(super) const LANES: usize = 16;

/// Rows that the inner loop handles at once: with 16 lanes, eight accumulators hide the latency
/// of the multiply-adds.
const ROWS: usize = 8;

/// `c` (m, n) = the first k columns of `a` (m, a_width) times `b` (k, n).
#[inline(always)]
pub(super) fn product(n: usize, k: usize, a: &[f32], a_width: usize, b: &[f32], c: &mut [f32]) {
    let m = (a.len() / a_width).min(c.len() / n);
    // A single row takes nearly as long as eight, so one that would be left over goes with the last eight: a clip of ten
    // frames has 17 rows, nine clean ones and eight to be learned.
    let with_one_more = usize::from(m % ROWS == 1 && m > ROWS);
    let whole = m / ROWS - with_one_more;
    let (a, a_rest) = a.split_at(whole * ROWS * a_width);
    let (c, c_rest) = c.split_at_mut(whole * ROWS * n);
    let blocks = a
        .chunks_exact(ROWS * a_width)
        .zip(c.chunks_exact_mut(ROWS * n));
    for (a, c) in blocks {
        rows::<ROWS>(n, k, a, a_width, b, c);
    }
    if with_one_more == 1 {
        return rows::<{ ROWS + 1 }>(n, k, a_rest, a_width, b, c_rest);
    }
    let rest = a_rest.chunks_exact(a_width).zip(c_rest.chunks_exact_mut(n));
    for (a, c) in rest {
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
        for m in [1, 7, 8, 9, 16, 17, 19] {
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
