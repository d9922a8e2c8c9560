//! Reductions of slices, for the bodies of [`vectorised`](super::vectorised) functions.
//!
//! Each keeps [`LANES`] partial results: a single one would be a chain of dependent operations,
//! which the compiler may not reorder. The order of the operations is fixed, so that results do
//! not depend on the instruction set.

use super::element::Float;
use super::simd::LANES;

/// The sum of `a` * `b`, for slices of one length.
#[inline(always)]
pub(crate) fn dot<T: Float>(a: &[f32], b: &[T]) -> f32 {
    let mut sums = [0.0_f32; LANES];
    let ((a, rest_a), (b, rest_b)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            sums[lane] = a[lane].mul_add(b[lane].to_f32(), sums[lane]);
        }
    }
    let rest = rest_a.iter().zip(rest_b);
    let rest: f32 = rest.map(|(a, b)| a * b.to_f32()).sum();
    total(sums) + rest
}

/// The sum of all lanes, by halves: one after the other, each addition would wait for the one before.
#[inline(always)]
fn total(sums: [f32; LANES]) -> f32 {
    let sums: [f32; LANES / 2] = halves(sums);
    let sums: [f32; LANES / 4] = halves(sums);
    let [a, b, c, d] = sums;
    (a + c) + (b + d)
}

/// The sums of both halves, lane by lane.
#[inline(always)]
fn halves<const ALL: usize, const HALF: usize>(lanes: [f32; ALL]) -> [f32; HALF] {
    std::array::from_fn(|lane| lanes[lane] + lanes[lane + HALF])
}

/// The sum of `f` of all values.
#[inline(always)]
pub(crate) fn sum_of(values: &[f32], f: impl Fn(f32) -> f32) -> f32 {
    let mut sums = [0.0_f32; LANES];
    let (chunks, rest) = values.as_chunks::<LANES>();
    for chunk in chunks {
        for (sum, value) in sums.iter_mut().zip(chunk) {
            *sum += f(*value);
        }
    }
    total(sums) + rest.iter().map(|value| f(*value)).sum::<f32>()
}

/// Replaces every value by `f` of it; the sum of what is there then.
#[inline(always)]
pub(crate) fn replace_and_sum(values: &mut [f32], f: impl Fn(f32) -> f32) -> f32 {
    let mut sums = [0.0_f32; LANES];
    let (chunks, rest) = values.as_chunks_mut::<LANES>();
    for chunk in chunks {
        for (sum, value) in sums.iter_mut().zip(chunk) {
            *value = f(*value);
            *sum += *value;
        }
    }
    let mut sum = total(sums);
    for value in rest {
        *value = f(*value);
        sum += *value;
    }
    sum
}

/// The largest value; -inf where there is none. What is no number is passed over.
#[inline(always)]
pub(crate) fn largest(values: &[f32]) -> f32 {
    let mut most = [f32::NEG_INFINITY; LANES];
    let (chunks, rest) = values.as_chunks::<LANES>();
    for chunk in chunks {
        for (most, value) in most.iter_mut().zip(chunk) {
            // One instruction, which `f32::max` is not.
            *most = if *value > *most { *value } else { *most };
        }
    }
    let all = most.iter().chain(rest).copied();
    all.fold(f32::NEG_INFINITY, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Small integers, so that sums are exact.
    fn numbers(len: usize, seed: usize) -> Vec<f32> {
        (0..len)
            .map(|i| ((i * 7 + seed) % 11) as f32 - 5.0)
            .collect()
    }

    #[test]
    fn every_length_is_reduced_whole() {
        for len in [0, 1, 15, 16, 17, 48, 50] {
            let (a, b) = (numbers(len, 1), numbers(len, 4));
            let product: f32 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
            assert_eq!(dot(&a, &b), product, "{len}");
            let squares: f32 = a.iter().map(|a| a * a).sum();
            assert_eq!(sum_of(&a, |a| a * a), squares, "{len}");
            let mut doubled = a.clone();
            assert_eq!(replace_and_sum(&mut doubled, |a| a * a), squares, "{len}");
            assert!(doubled.iter().zip(&a).all(|(d, a)| *d == a * a), "{len}");
            let most = a.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            assert_eq!(largest(&a), most, "{len}");
        }
    }
}
