//! Activation functions, in place; the stock ones are a call of the C library per value.

use rayon::prelude::*;

use super::exponential::{exp, sigmoid};
use super::vectorised::vectorised;

/// Values that one task handles.
const CHUNK: usize = 16 * 1024;

/// x times the logistic function of x.
pub fn silu(values: &mut [f32]) {
    values.par_chunks_mut(CHUNK).for_each(silu_chunk);
}

/// x times the normal distribution function of x, to 2e-7 of 1: `torch.nn.GELU()`.
pub fn gelu_exact(values: &mut [f32]) {
    values.par_chunks_mut(CHUNK).for_each(gelu_exact_chunk);
}

/// The approximation of [`gelu_exact`] with tanh: `torch.nn.GELU(approximate="tanh")`.
pub fn gelu_tanh(values: &mut [f32]) {
    values.par_chunks_mut(CHUNK).for_each(gelu_tanh_chunk);
}

vectorised! {
    /// As [`silu`], on the calling thread.
    pub(crate) fn silu_chunk(values: &mut [f32]) {
        for value in values {
            *value *= sigmoid(*value);
        }
    }
}

vectorised! {
    fn gelu_tanh_chunk(values: &mut [f32]) {
        // 1 + tanh(y) = 2 sigmoid(2 y)
        const SCALE: f32 = 2.0 * 0.797_884_6;
        for value in values {
            let x = *value;
            let cube = x * x * x;
            *value = x * sigmoid(SCALE * cube.mul_add(0.044_715, x));
        }
    }
}

vectorised! {
    fn gelu_exact_chunk(values: &mut [f32]) {
        for value in values {
            let x = *value;
            // Half the complementary error function of |x| / sqrt 2: the tail of the distribution.
            let tail = 0.5 * erfc(x.abs() * std::f32::consts::FRAC_1_SQRT_2);
            *value = x * if x < 0.0 { tail } else { 1.0 - tail };
        }
    }
}

/// The complementary error function for z >= 0, to 1.5e-7: Abramowitz and Stegun, 7.1.26.
#[inline(always)]
fn erfc(z: f32) -> f32 {
    let t = 1.0 / 0.327_591_1_f32.mul_add(z, 1.0);
    let mut p = 1.061_405_4_f32;
    p = p.mul_add(t, -1.453_152);
    p = p.mul_add(t, 1.421_413_7);
    p = p.mul_add(t, -0.284_496_74);
    p = p.mul_add(t, 0.254_829_6);
    p * t * exp(-z * z)
}

#[cfg(test)]
mod tests {
    use candle_core::{Device, Tensor};

    use super::*;

    #[test]
    fn each_is_that_of_the_stock_library() {
        let x: Vec<f32> = (-2000..2000).map(|i| i as f32 * 0.005).collect();
        let tensor = Tensor::from_slice(&x, x.len(), &Device::Cpu).unwrap();
        let of = |function: fn(&mut [f32])| {
            let mut y = x.clone();
            function(&mut y);
            y
        };
        for (y, expected) in [
            (of(silu), tensor.silu().unwrap()),
            (of(gelu_exact), tensor.gelu_erf().unwrap()),
            (of(gelu_tanh), tensor.gelu().unwrap()),
        ] {
            for ((x, y), expected) in x.iter().zip(&y).zip(expected.to_vec1::<f32>().unwrap()) {
                let tolerance = 1e-6 * (1.0 + x.abs());
                assert!((y - expected).abs() < tolerance, "{x}: {y}, {expected}");
            }
        }
    }
}
