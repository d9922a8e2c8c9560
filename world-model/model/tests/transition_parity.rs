//! The transition model against an independent implementation in PyTorch
//! (fixtures/generate_transition.py).

use std::path::Path;

use candle_core::{Device, Tensor};
use serde_json::Value;
use wm_model::NumberFormat;
use wm_model::Weights;
use wm_model::ops::RopeLayout;
use wm_model::transition::{PackedTransition, TensorTransition, Transition, TransitionConfig};

/// Difference allowed, as a part of the largest velocity.
const TOLERANCE: f32 = 1e-4;
/// Weights are rounded to 8 bits, and where the processor multiplies bf16, what they are multiplied with as well.
const BF16_TOLERANCE: f32 = 3e-2;
/// What `docs/models.md` promises.
const INT8_TOLERANCE: f32 = 5e-2;

fn fixture() -> Weights {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/transition.safetensors");
    Weights::open(path).unwrap()
}

fn tensor(weights: &Weights, name: &str) -> Tensor {
    let shape = weights.shape(name).unwrap().to_vec();
    weights.tensor(name, &shape).unwrap()
}

fn most(tensor: &Tensor) -> f32 {
    tensor
        .abs()
        .unwrap()
        .max_all()
        .unwrap()
        .to_scalar()
        .unwrap()
}

fn config(case: &Value) -> TransitionConfig {
    let size = |key: &str| case[key].as_u64().map(|value| value as usize);
    let latent = (
        size("height").unwrap(),
        size("width").unwrap(),
        size("channels").unwrap(),
    );
    TransitionConfig {
        hidden: size("d").unwrap(),
        depth: size("depth").unwrap(),
        heads: size("heads").unwrap(),
        wide_head: size("wide"),
        views: size("views").unwrap_or(1),
        rope_layout: match case.get("rope_layout") {
            Some(layout) => serde_json::from_value(layout.clone()).unwrap(),
            None => RopeLayout::default(),
        },
        ..TransitionConfig::preset("dit-s", latent, size("patch").unwrap(), 10).unwrap()
    }
}

#[test]
fn velocities_are_those_of_pytorch() {
    let weights = fixture();
    let cases: Value = weights.json("cases").unwrap();
    let cases = cases.as_object().unwrap();
    assert_eq!(
        cases.len(),
        7,
        "plain and wide head, patch 1 and 2, several views in both layouts"
    );
    for (name, case) in cases {
        let config = config(case);
        let prefix = format!("{name}/");
        let stored = weights
            .names()
            .iter()
            .filter(|n| n.starts_with(&prefix))
            .count();
        let mut asked = 0;
        let model = Transition::build(config, &mut |parameter| {
            asked += 1;
            weights.tensor(&format!("{prefix}{}", parameter.name), &parameter.shape)
        })
        .unwrap();
        assert_eq!(
            asked, stored,
            "{name}: parameters that PyTorch has and we do not"
        );
        let input = |what: &str| tensor(&weights, &format!("{name}:{what}"));
        let inputs = (&input("x"), &input("tau"), &input("action"));
        let packed = |format| PackedTransition::new(&model, format).unwrap();
        let expected = input("velocity");
        for (what, velocity, tolerance) in [
            (
                "tensors",
                model.forward(inputs.0, inputs.1, inputs.2),
                TOLERANCE,
            ),
            (
                "plain tensors",
                model.clone().plain().forward(inputs.0, inputs.1, inputs.2),
                TOLERANCE,
            ),
            (
                "tensors for inference",
                TensorTransition::new(model.clone(), true)
                    .unwrap()
                    .forward(inputs.0, inputs.1, inputs.2),
                TOLERANCE,
            ),
            (
                "packed",
                packed(NumberFormat::F32).forward(inputs.0, inputs.1, inputs.2),
                TOLERANCE,
            ),
            (
                "packed in bf16",
                packed(NumberFormat::Bf16).forward(inputs.0, inputs.1, inputs.2),
                BF16_TOLERANCE,
            ),
            (
                "packed in int8",
                packed(NumberFormat::Int8).forward(inputs.0, inputs.1, inputs.2),
                INT8_TOLERANCE,
            ),
        ] {
            let difference = most(&(velocity.unwrap() - &expected).unwrap()) / most(&expected);
            println!("{name}, {what}: {difference:.1e} of the largest velocity");
            assert!(difference < tolerance, "{name}, {what}: {difference}");
        }
    }
}

#[test]
fn the_model_runs_on_the_cpu_whatever_the_batch_is() {
    let config = TransitionConfig::preset("tiny", (4, 4, 4), 2, 7).unwrap();
    let model = Transition::random(config, 1).unwrap();
    let zeros =
        |shape: &[usize]| Tensor::zeros(shape, candle_core::DType::F32, &Device::Cpu).unwrap();
    for batch in [1, 3] {
        let velocity = model
            .forward(
                &zeros(&[batch, 2, 4, 4, 4]),
                &zeros(&[batch, 2]),
                &zeros(&[batch, 2, 7]),
            )
            .unwrap();
        assert_eq!(velocity.dims(), [batch, 2, 4, 4, 4]);
    }
    let wrong = model.forward(
        &zeros(&[1, 2, 4, 4, 5]),
        &zeros(&[1, 2]),
        &zeros(&[1, 2, 7]),
    );
    assert!(wrong.unwrap_err().to_string().contains("(B, T, 4, 4, 4)"));
}
