//! Which form of an operation computes.

use candle_core::Tensor;

/// Which form of an operation computes. Both give the same numbers, to rounding, and both have gradients.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Form {
    /// The kernel where there is one: for tensors on the CPU. Elsewhere the plain form.
    #[default]
    Kernel,
    /// Stock operations, on any device: the reference.
    Plain,
}

impl Form {
    /// Whether the kernel is to compute `x`, and can.
    pub(super) fn takes_kernel(self, x: &Tensor) -> bool {
        self == Self::Kernel && x.device().is_cpu()
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

    /// Checks that both forms give the same, to 1e-5 where values are about 1.
    pub(in crate::ops) fn check_same(what: &str, compute: impl Fn(Form) -> Result<Tensor>) {
        let (kernel, plain) = (
            compute(Form::Kernel).unwrap(),
            compute(Form::Plain).unwrap(),
        );
        assert_eq!(kernel.dims(), plain.dims(), "{what}");
        let difference = (kernel - plain).unwrap().abs().unwrap();
        let most: f32 = difference.max_all().unwrap().to_scalar().unwrap();
        assert!(most < 1e-5, "{what}: the forms differ by {most}");
    }

    /// Checks that both forms refuse, and why.
    pub(in crate::ops) fn check_refused(why: &str, compute: impl Fn(Form) -> Result<Tensor>) {
        for form in [Form::Kernel, Form::Plain] {
            let message = compute(form).unwrap_err().to_string();
            assert!(message.contains(why), "{form:?}: {message}");
        }
    }
}
