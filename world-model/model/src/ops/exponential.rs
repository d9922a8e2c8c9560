//! An exponential that the compiler can vectorise; the one of the standard library is a call per
//! value.

/// e^x with a relative error below 2e-7, for any finite x; below -87 the result is about 1e-38.
///
/// Range reduction to x = n ln 2 + r with |r| <= ln 2 / 2, then the minimax polynomial of the
/// Cephes library for e^r.
#[inline(always)]
// The constants are Cephes' own decimal expansions, kept as published.
#[allow(clippy::excessive_precision, clippy::approx_constant)]
pub(crate) fn exp(x: f32) -> f32 {
    // Beyond these bounds 2^n is no normal f32.
    let x = x.clamp(-87.0, 88.0);
    let n = (x * std::f32::consts::LOG2_E).round_ties_even();
    // ln 2 in two parts, so that n * ln 2 is subtracted without loss.
    let r = n.mul_add(-0.693359375, x);
    let r = n.mul_add(2.12194440e-4, r);
    let mut p = 1.9875691500e-4_f32;
    p = p.mul_add(r, 1.3981999507e-3);
    p = p.mul_add(r, 8.3334519073e-3);
    p = p.mul_add(r, 4.1665795894e-2);
    p = p.mul_add(r, 1.6666665459e-1);
    p = p.mul_add(r, 5.0000001201e-1);
    let e = p.mul_add(r * r, r) + 1.0;
    // The magic number puts n into the low bits of the float, which is cheaper than a conversion.
    let bits = (n + 12_582_912.0).to_bits() << 23;
    e * f32::from_bits(bits.wrapping_add(127 << 23))
}

/// 1 / (1 + e^-x).
#[inline(always)]
pub(crate) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_that_of_the_standard_library() {
        for i in -8600..8700 {
            let x = i as f32 * 0.01;
            let (got, expected) = (f64::from(exp(x)), f64::from(x).exp());
            assert!(
                ((got - expected) / expected).abs() < 3e-7,
                "exp({x}) = {got}, expected {expected}"
            );
        }
        assert!(exp(f32::NEG_INFINITY) < 1.0e-37);
    }
}
