//! Comparisons of the two kinds of kernels, for tests.

/// The kernels of a layer.
pub use crate::compute::Kernels as Engine;

#[cfg(test)]
pub(super) mod tests {
    use candle_core::{Device, Result, Tensor, Var};
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

    /// Step of the differences: small enough for what is left of fourth order, large enough for what is lost to rounding.
    const STEP: f32 = 1.0 / 32.0;

    /// Checks on both engines the gradient by every value of every input, against differences of fourth order of the sum
    /// of all results, each times a factor of its own; to 1e-4 of each input's gradient.
    pub(in crate::ops) fn check_gradients(
        what: &str,
        inputs: &[Tensor],
        compute: impl Fn(Engine, &[Tensor]) -> Result<Tensor>,
    ) {
        for engine in [Engine::Cpu, Engine::Candle] {
            let variables: Vec<Var> = inputs
                .iter()
                .map(|x| Var::from_tensor(x).unwrap())
                .collect();
            let given: Vec<Tensor> = variables.iter().map(|x| x.as_tensor().clone()).collect();
            let out = compute(engine, &given).unwrap();
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
                    let out = flat(&compute(engine, &moved).unwrap());
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
                println!("{what}, {engine}, by input {place}: {error:.1e}");
                assert!(error < 1e-4, "{what}, {engine}, by input {place}: {error}");
            }
        }
    }

    fn flat(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    /// Checks that both engines refuse, and why.
    pub(in crate::ops) fn check_refused(why: &str, compute: impl Fn(Engine) -> Result<Tensor>) {
        for engine in [Engine::Cpu, Engine::Candle] {
            let message = compute(engine).unwrap_err().to_string();
            assert!(message.contains(why), "{engine:?}: {message}");
        }
    }
}
