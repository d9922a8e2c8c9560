//! Evening out what 8 bits are to hold: between a matrix and its inputs.

use super::length::check_length;
use crate::{Error, Result};

/// What is known of the inputs of a matrix that is to be quantised.
///
/// A few inputs of a transformer's layer are often far larger than the others, and a row that is rounded to 8 bits with one
/// scale has little left for those. So inputs are divided by a factor of their own, and the weights that they meet are
/// multiplied with it, which the products do not notice (SmoothQuant, Xiao et al. 2023, <https://arxiv.org/abs/2211.10438>,
/// equation 4):
///
/// ```text
/// max|x_j|^strength / max|w_j|^(1 - strength)
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Smoothing<'a> {
    /// The largest absolute value of every input.
    pub largest: &'a [f32],
    /// How much of the difficulty moves from the inputs to the weights, 0 to 1.
    pub strength: f32,
}

impl Smoothing<'_> {
    /// What every input is to be multiplied with; 1 where one is always zero, or meets zeros.
    ///
    /// # Errors
    /// If a value is not finite or negative, there are not as many as inputs, or the strength is out of range.
    pub(super) fn factors(&self, weight: &[f32], inputs: usize) -> Result<Vec<f32>> {
        check_length("the largest inputs of a matrix", self.largest, inputs)?;
        let strength = self.strength;
        if !(0.0..=1.0).contains(&strength) {
            let reason = format!("a strength of {strength}, expected 0 to 1");
            return Err(Error::config("smoothing", reason));
        }
        let mut weights = vec![0f32; inputs];
        for row in weight.chunks_exact(inputs.max(1)) {
            for (most, w) in weights.iter_mut().zip(row) {
                *most = most.max(w.abs());
            }
        }
        let factors = self.largest.iter().zip(weights).map(|(&input, weight)| {
            if !input.is_finite() || input < 0.0 {
                let reason = format!("{input} as the largest absolute value of an input");
                return Err(Error::config("smoothing", reason));
            }
            let factor = weight.powf(1.0 - strength) / input.powf(strength);
            // Not where either is zero, or so near that nothing is left of the other.
            Ok(if factor.is_normal() && factor.recip().is_normal() {
                factor
            } else {
                1.0
            })
        });
        factors.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_large_is_shared() {
        let smoothing = |largest, strength| Smoothing { largest, strength };
        // Two outputs of four inputs.
        let weight = [1.0, 0.5, 0.0, 4.0, -4.0, 0.1, 0.0, 2.0];
        let half = smoothing(&[16.0, 0.5, 3.0, 0.0], 0.5);
        assert_eq!(half.factors(&weight, 4).unwrap(), [0.5, 1.0, 1.0, 1.0]);
        let all = smoothing(&[16.0, 0.5, 3.0, 0.0], 1.0);
        assert_eq!(
            all.factors(&weight, 4).unwrap(),
            [1.0 / 16.0, 2.0, 1.0 / 3.0, 1.0]
        );
        let none = smoothing(&[16.0, 0.5, 3.0, 0.0], 0.0);
        assert_eq!(none.factors(&weight, 4).unwrap(), [4.0, 0.5, 1.0, 4.0]);
        for (wrong, message) in [
            (smoothing(&[1.0; 3], 0.5), "[4]"),
            (smoothing(&[1.0; 4], 1.5), "1.5"),
            (smoothing(&[1.0; 4], f32::NAN), "NaN"),
            (smoothing(&[1.0, -1.0, 1.0, 1.0], 0.5), "-1"),
            (smoothing(&[1.0, 1.0, f32::INFINITY, 1.0], 0.5), "inf"),
        ] {
            let error = wrong.factors(&weight, 4).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
