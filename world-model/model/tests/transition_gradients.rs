//! Every operation that the transition model trains through, its gradient against finite
//! differences, on both engines.

#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use candle_core::{Device, Tensor, Var};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use wm_model::ops::{
    AttentionPattern, Axis, Engine, RotaryTable, attention, gated_residual, linear,
    rms_norm_modulate, swiglu,
};

fn random(shape: &[usize], seed: u64) -> Tensor {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let values: Vec<f32> = (0..shape.iter().product())
        .map(|_| StandardNormal.sample(&mut rng))
        .collect();
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

fn values(tensor: &Tensor) -> Vec<f32> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

/// Checks an operation on both engines.
fn check(
    name: &str,
    shapes: &[&[usize]],
    f: impl Fn(Engine, &[Tensor]) -> candle_core::Result<Tensor>,
) {
    for engine in [Engine::Cpu, Engine::Candle] {
        check_engine(&format!("{name}, {engine:?}"), shapes, |t| f(engine, t));
    }
}

/// Compares the gradient of a random linear function of `f`'s result, for every input, with
/// central differences at every 7th value.
fn check_engine(
    name: &str,
    shapes: &[&[usize]],
    f: impl Fn(&[Tensor]) -> candle_core::Result<Tensor>,
) {
    let inputs: Vec<Var> = shapes
        .iter()
        .enumerate()
        .map(|(i, shape)| Var::from_tensor(&random(shape, i as u64)).unwrap())
        .collect();
    let tracked: Vec<Tensor> = inputs.iter().map(|v| v.as_tensor().clone()).collect();
    let result = f(&tracked).unwrap();
    let weights = random(result.dims(), 99);
    // Summed in f64: the differences are small against the sum.
    let loss = |inputs: &[Tensor]| -> f64 {
        let result = values(&f(inputs).unwrap());
        let weighted = result.iter().zip(values(&weights));
        weighted.map(|(a, b)| f64::from(*a) * f64::from(b)).sum()
    };
    let total = (result * &weights).unwrap().sum_all().unwrap();
    let gradients = total.backward().unwrap();
    for (i, input) in inputs.iter().enumerate() {
        let gradient = gradients
            .get(input)
            .unwrap_or_else(|| panic!("{name}: input {i} has none"));
        let gradient = values(gradient);
        let size = gradient.iter().fold(0.0_f32, |most, g| most.max(g.abs()));
        let at = values(input);
        for place in (0..at.len()).step_by(7) {
            let step = 1e-2;
            let moved = |by: f32| {
                let mut at = at.clone();
                at[place] += by;
                let mut inputs: Vec<Tensor> =
                    inputs.iter().map(|v| v.as_detached_tensor()).collect();
                inputs[i] = Tensor::from_vec(at, shapes[i], &Device::Cpu).unwrap();
                loss(&inputs)
            };
            // Fourth order, since the functions bend.
            let near = moved(step) - moved(-step);
            let far = moved(2.0 * step) - moved(-2.0 * step);
            let numeric = (8.0 * near - far) / (12.0 * f64::from(step));
            let difference = (f64::from(gradient[place]) - numeric).abs();
            assert!(
                difference < 2e-3 * f64::from(size.max(1.0)),
                "{name}: input {i} at {place}: {} by backward, {numeric} by differences",
                gradient[place]
            );
        }
    }
}

#[test]
fn linear_has_its_gradient() {
    check("linear", &[&[2, 5, 16], &[9, 16], &[9]], |engine, t| {
        linear(engine, &t[0], &t[1], Some(&t[2]))
    });
    check("linear without bias", &[&[3, 16], &[9, 16]], |engine, t| {
        linear(engine, &t[0], &t[1], None)
    });
}

#[test]
fn rms_norm_modulate_has_its_gradient() {
    check(
        "rms_norm_modulate",
        &[&[1, 2, 3, 24], &[2, 72]],
        |engine, t| rms_norm_modulate(engine, &t[0], &t[1], 2, 0),
    );
}

#[test]
fn gated_residual_has_its_gradient() {
    check(
        "gated_residual",
        &[&[1, 2, 3, 16], &[1, 2, 3, 16], &[2, 48]],
        |engine, t| gated_residual(engine, &t[0], &t[1], &t[2], 1),
    );
}

#[test]
fn swiglu_has_its_gradient() {
    check("swiglu", &[&[3, 40]], |engine, t| swiglu(engine, &t[0]));
}

#[test]
fn spatial_attention_has_its_gradient() {
    let rotary = RotaryTable::grid(2, 3, 16);
    let pattern = AttentionPattern::new(Axis::Space, 2, rotary, |_, _| true).unwrap();
    let pattern = Arc::new(pattern);
    check("spatial attention", &[&[1, 2, 6, 96]], |engine, t| {
        attention(engine, &t[0], &pattern)
    });
}

#[test]
fn temporal_attention_has_its_gradient() {
    let rotary = RotaryTable::sequence(&[0, 1, 1, 2], 16);
    let visible = |query: usize, key: usize| key <= query && key != 1;
    let visible = move |query: usize, key: usize| query == key || visible(query, key);
    let pattern = Arc::new(AttentionPattern::new(Axis::Time, 2, rotary, visible).unwrap());
    check("temporal attention", &[&[2, 4, 3, 96]], |engine, t| {
        attention(engine, &t[0], &pattern)
    });
}
