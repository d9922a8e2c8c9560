//! Comparisons of the two kinds of kernels, for tests.

#![allow(clippy::unwrap_used, clippy::indexing_slicing)] // the helpers of tests, not only what is marked #[test]

use candle_core::{Device, Result, Tensor, Var};

use crate::{Kernels, random};

/// Normally distributed values, the same ones for a seed.
pub(super) fn random(shape: &[usize], seed: u64) -> Tensor {
    random::normal(shape, seed).unwrap()
}

/// Checks that both kinds of kernels give the same, to 1e-5 where values are about 1.
pub(super) fn check_same(what: &str, compute: impl Fn(Kernels) -> Result<Tensor>) {
    let (kernel, plain) = (
        compute(Kernels::Cpu).unwrap(),
        compute(Kernels::Candle).unwrap(),
    );
    assert_eq!(kernel.dims(), plain.dims(), "{what}");
    let difference = (kernel - plain).unwrap().abs().unwrap();
    let most: f32 = difference.max_all().unwrap().to_scalar().unwrap();
    assert!(most < 1e-5, "{what}: the kernels differ by {most}");
}

/// Step of the differences: small enough for what is left of fourth order, large enough for what is lost to rounding.
const STEP: f32 = 1.0 / 32.0;

/// Checks on both kinds of kernels the gradient by every value of every input, against differences of fourth order of the sum
/// of all results, each times a factor of its own; to 1e-4 of each input's gradient.
pub(super) fn check_gradients(
    what: &str,
    inputs: &[Tensor],
    compute: impl Fn(Kernels, &[Tensor]) -> Result<Tensor>,
) {
    for kernels in [Kernels::Cpu, Kernels::Candle] {
        let variables: Vec<Var> = inputs
            .iter()
            .map(|x| Var::from_tensor(x).unwrap())
            .collect();
        let given: Vec<Tensor> = variables.iter().map(|x| x.as_tensor().clone()).collect();
        let out = compute(kernels, &given).unwrap();
        let factors = random(out.dims(), 99);
        let loss = (out * &factors).unwrap().sum_all().unwrap();
        let gradients = loss.backward().unwrap();
        let factors = flat(&factors);
        for (place, variable) in variables.iter().enumerate() {
            let at = |index: usize, offset: f32| {
                let mut values = flat(&inputs[place]);
                values[index] += offset;
                let mut moved = inputs.to_vec();
                moved[place] =
                    Tensor::from_vec(values, inputs[place].shape(), &Device::Cpu).unwrap();
                let out = flat(&compute(kernels, &moved).unwrap());
                let products = out.iter().zip(&factors);
                products
                    .map(|(x, factor)| f64::from(*x) * f64::from(*factor))
                    .sum::<f64>()
            };
            let found = flat(gradients.get(variable).unwrap());
            let (mut squares, mut errors) = (0.0, 0.0);
            for (index, found) in found.iter().enumerate() {
                let near = at(index, STEP) - at(index, -STEP);
                let far = at(index, 2.0 * STEP) - at(index, -2.0 * STEP);
                let slope = (8.0 * near - far) / (12.0 * f64::from(STEP));
                squares += slope * slope;
                errors += (f64::from(*found) - slope).powi(2);
            }
            let error = (errors / squares).sqrt();
            println!("{what}, {kernels}, by input {place}: {error:.1e}");
            assert!(error < 1e-4, "{what}, {kernels}, by input {place}: {error}");
        }
    }
}

fn flat(x: &Tensor) -> Vec<f32> {
    x.flatten_all().unwrap().to_vec1().unwrap()
}

/// Checks that both kinds of kernels refuse, and why.
pub(super) fn check_refused(why: &str, compute: impl Fn(Kernels) -> Result<Tensor>) {
    for kernels in [Kernels::Cpu, Kernels::Candle] {
        let message = compute(kernels).unwrap_err().to_string();
        assert!(message.contains(why), "{kernels:?}: {message}");
    }
}
