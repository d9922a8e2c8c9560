//! Dropout, for training.

use candle_core::Tensor;
use rand::Rng as _;
use rand_chacha::ChaCha8Rng;

use crate::Result;

/// Sets random values to zero in training; does nothing otherwise.
#[derive(Debug, Default)]
pub struct Dropout<'r>(Option<(f64, &'r mut ChaCha8Rng)>);

impl<'r> Dropout<'r> {
    /// Drops this part of the values, in 0..1; which ones, `rng` decides.
    pub fn new(part: f64, rng: &'r mut ChaCha8Rng) -> Self {
        Self((part > 0.0).then_some((part, rng)))
    }

    /// Nothing is dropped.
    pub fn none() -> Self {
        Self(None)
    }

    /// Whether nothing is dropped.
    pub fn is_none(&self) -> bool {
        self.0.is_none()
    }

    /// `x` with values dropped and the others divided by the part that is kept, so that the mean stays.
    ///
    /// # Errors
    /// If the tensor operation fails.
    pub fn apply(&mut self, x: &Tensor) -> Result<Tensor> {
        let Some((part, rng)) = &mut self.0 else {
            return Ok(x.clone());
        };
        let scale = (1.0 / (1.0 - *part)) as f32;
        let kept: Vec<f32> = (0..x.elem_count())
            .map(|_| if rng.random_bool(*part) { 0.0 } else { scale })
            .collect();
        let kept = Tensor::from_vec(kept, x.shape(), x.device())?;
        Ok((x * kept.to_dtype(x.dtype())?)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Device};
    use rand::SeedableRng as _;

    #[test]
    fn the_mean_stays_and_the_seed_decides() {
        let x = Tensor::ones(10_000, DType::F32, &Device::Cpu).unwrap();
        let drop = |seed| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let dropped = Dropout::new(0.1, &mut rng).apply(&x).unwrap();
            dropped.to_vec1::<f32>().unwrap()
        };
        let (first, again, other) = (drop(1), drop(1), drop(2));
        assert!(first == again && first != other);
        let zeros = first.iter().filter(|x| **x == 0.0).count();
        assert!((900..1100).contains(&zeros), "{zeros}");
        let mean = first.iter().sum::<f32>() / 1e4;
        assert!((mean - 1.0).abs() < 0.02, "{mean}");
        let same = Dropout::none().apply(&x).unwrap().to_vec1::<f32>().unwrap();
        assert!(same.iter().all(|x| *x == 1.0));
    }
}
