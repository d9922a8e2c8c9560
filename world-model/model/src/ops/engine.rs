//! What computes.

use std::fmt;
use std::str::FromStr;

use candle_core::Tensor;

use crate::Error;

/// What computes a model's layers. Both engines give the same numbers, to rounding, and both have gradients.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// Candle's own operations: any device, the reference.
    Candle,
    /// Our kernels, for f32 tensors on the CPU, and weights of f32 or bf16 that are packed once. A layer that has no kernel
    /// takes candle's operations.
    #[default]
    Cpu,
}

impl Engine {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Candle => "candle",
            Self::Cpu => "cpu",
        }
    }

    /// Whether the kernel is to compute `x`, and can.
    pub(super) fn takes_kernel(self, x: &Tensor) -> bool {
        self == Self::Cpu && x.device().is_cpu()
    }
}

impl fmt::Display for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Engine {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        [Self::Candle, Self::Cpu]
            .into_iter()
            .find(|engine| engine.name() == name)
            .ok_or_else(|| Error::config("engine", format!("`{name}`, expected candle or cpu")))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use candle_core::{Device, Result};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// Normally distributed values, the same ones for a seed.
    pub(in crate::ops) fn random(shape: &[usize], seed: u64) -> Tensor {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let values: Vec<f32> = (0..shape.iter().product())
            .map(|_| StandardNormal.sample(&mut rng))
            .collect();
        Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
    }

    /// Checks that both engines give the same, to 1e-5 where values are about 1.
    pub(in crate::ops) fn check_same(what: &str, compute: impl Fn(Engine) -> Result<Tensor>) {
        let (kernel, plain) = (
            compute(Engine::Cpu).unwrap(),
            compute(Engine::Candle).unwrap(),
        );
        assert_eq!(kernel.dims(), plain.dims(), "{what}");
        let difference = (kernel - plain).unwrap().abs().unwrap();
        let most: f32 = difference.max_all().unwrap().to_scalar().unwrap();
        assert!(most < 1e-5, "{what}: the engines differ by {most}");
    }

    /// Checks that both engines refuse, and why.
    pub(in crate::ops) fn check_refused(why: &str, compute: impl Fn(Engine) -> Result<Tensor>) {
        for engine in [Engine::Cpu, Engine::Candle] {
            let message = compute(engine).unwrap_err().to_string();
            assert!(message.contains(why), "{engine:?}: {message}");
        }
    }

    #[test]
    fn names_are_read_back() {
        for engine in [Engine::Candle, Engine::Cpu] {
            assert_eq!(engine.to_string().parse::<Engine>().unwrap(), engine);
        }
        let message = "gpu".parse::<Engine>().unwrap_err().to_string();
        assert!(message.contains("`gpu`"), "{message}");
    }
}
