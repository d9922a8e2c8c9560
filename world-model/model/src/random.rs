//! Random tensors for tests and benchmarks, the same for the same seed: candle's generator on the CPU takes no seed.

use candle_core::{Device, Result, Tensor};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, StandardUniform};

/// Values of the standard normal distribution.
///
/// # Errors
/// If the tensor cannot be made.
pub fn normal(shape: &[usize], seed: u64) -> Result<Tensor> {
    draw(StandardNormal, shape, seed)
}

/// Values from 0 to below 1.
///
/// # Errors
/// If the tensor cannot be made.
pub fn uniform(shape: &[usize], seed: u64) -> Result<Tensor> {
    draw(StandardUniform, shape, seed)
}

fn draw(distribution: impl Distribution<f32>, shape: &[usize], seed: u64) -> Result<Tensor> {
    let values = ChaCha8Rng::seed_from_u64(seed).sample_iter(distribution);
    let values: Vec<f32> = values.take(shape.iter().product()).collect();
    Tensor::from_vec(values, shape, &Device::Cpu)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_decides_every_value() {
        for draw in [normal, uniform] {
            let values = |seed| draw(&[2, 3], seed).unwrap().to_vec2::<f32>().unwrap();
            assert_eq!(values(1), values(1));
            assert_ne!(values(1), values(2));
        }
    }
}
