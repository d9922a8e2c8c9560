use candle_core::{DType, Device, Var};

use super::*;

/// A model of random parameters, of which those whose names hold `rounded` are in bf16.
fn model(rounded: &str) -> Result<Transition> {
    let config = TransitionConfig {
        wide_head: Some(48),
        ..TransitionConfig::preset("tiny", (4, 4, 4), 2, 7)?
    };
    Transition::build(config, &mut |parameter| {
        let tensor = parameter.sample(1)?;
        Ok(match parameter.name.contains(rounded) {
            true => tensor.to_dtype(DType::BF16)?,
            false => tensor,
        })
    })
}

/// Normally distributed values, the same ones for a name.
fn random(name: &str, shape: &[usize]) -> Tensor {
    let parameter = Parameter {
        name: name.to_owned(),
        shape: shape.to_vec(),
        initialisation: Initialisation::Normal(1.0),
    };
    parameter.initial(2).unwrap()
}

fn norm(x: &Tensor) -> f32 {
    let sum = x.sqr().unwrap().sum_all().unwrap();
    sum.to_scalar::<f32>().unwrap().sqrt()
}

#[test]
fn parameters_of_sixteen_bits_take_and_give_f32() {
    let x = random("x", &[2, 3, 4, 4, 4]);
    let tau = Tensor::new(&[[0.1_f32, 0.4, 1.0], [0.7, 0.2, 0.9]], &Device::Cpu).unwrap();
    let action = random("action", &[2, 3, 7]);
    let velocity = |model: Transition| model.forward(&x, &tau, &action).unwrap();
    let exact = velocity(model("none").unwrap());
    let rounded = velocity(model("").unwrap().plain());
    let difference = norm(&(&rounded - &exact).unwrap()) / norm(&exact);
    // Weights, inputs and outputs of every product have eight bits, 0.2 % each, and ten layers follow each other.
    assert!((1e-3..5e-2).contains(&difference), "{difference}");
}

#[test]
fn parameters_of_several_formats_are_refused() {
    let message = model("action_embedder.bias").unwrap_err().to_string();
    let expected = "`action_embedder.bias` is BF16 on Cpu, expected F32 on Cpu";
    assert!(message.contains(expected), "{message}");
}

/// Of a loss that runs the model twice, so that gradients by the same weight add up.
#[test]
fn collected_gradients_are_those_of_candle() {
    let config = TransitionConfig {
        depth: 2,
        ..TransitionConfig::preset("tiny", (4, 4, 3), 2, 7).unwrap()
    };
    let mut variables = Vec::new();
    let model = Transition::build(config, &mut |parameter| {
        let variable = Var::from_tensor(&parameter.sample(1)?)?;
        let tensor = variable.as_tensor().clone();
        variables.push((parameter.name.clone(), variable));
        Ok(tensor)
    })
    .unwrap();
    let x = random("x", &[2, 3, 4, 4, 3]);
    let (tau, action) = (random("tau", &[2, 3]), random("action", &[2, 3, 7]));
    let pattern = TemporalPattern::causal(3);
    for last in 1..=3 {
        let loss = |model: &Transition| {
            let once = model.output(&x, &tau, &action, &pattern, 3).unwrap();
            let twice = model.output(&once, &tau, &action, &pattern, last).unwrap();
            let (once, twice) = (once.sqr().unwrap(), twice.sqr().unwrap());
            (once.sum_all().unwrap() + twice.sum_all().unwrap()).unwrap()
        };
        let expected = loss(&model).backward().unwrap();
        let gradients = WeightGradients::default();
        let store = loss(&model.collecting(&gradients)).backward().unwrap();
        for (name, variable) in &variables {
            let expected = expected.get(variable).unwrap();
            let found = gradients.take(variable, &store).unwrap().unwrap();
            let found = Tensor::from_vec(found, variable.shape(), &Device::Cpu).unwrap();
            let error = (expected - found).unwrap();
            let relative = norm(&error) / norm(expected);
            assert!(relative < 1e-5, "{name}, last {last}: {relative:.1e}");
        }
    }
}

#[test]
fn the_last_frames_are_those_of_all() {
    let config = TransitionConfig::preset("tiny", (4, 4, 3), 2, 7).unwrap();
    let model = Transition::random(config, 3).unwrap();
    let x = random("x", &[2, 3, 4, 4, 3]);
    let (tau, action) = (random("tau", &[2, 3]), random("action", &[2, 3, 7]));
    let pattern = TemporalPattern::causal(3);
    let output = |model: &Transition, last| model.output(&x, &tau, &action, &pattern, last);
    let all = output(&model, 3).unwrap();
    let collecting = model.collecting(&WeightGradients::default());
    for last in 1..=3 {
        let expected = all.narrow(1, 3 - last, last).unwrap();
        for model in [&model, &collecting] {
            let error = (output(model, last).unwrap() - &expected).unwrap();
            assert!(norm(&error) / norm(&expected) < 1e-6, "last {last}");
        }
    }
    for last in [0, 4] {
        let error = output(&model, last).unwrap_err().to_string();
        assert!(
            error.contains(&format!("{last}, expected 1 to 3")),
            "{error}"
        );
    }
}
