use candle_core::DType;

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

#[test]
fn parameters_of_sixteen_bits_take_and_give_f32() {
    let x = random("x", &[2, 3, 4, 4, 4]);
    let tau = Tensor::new(&[[0.1_f32, 0.4, 1.0], [0.7, 0.2, 0.9]], &Device::Cpu).unwrap();
    let action = random("action", &[2, 3, 7]);
    let velocity = |model: Transition| model.forward(&x, &tau, &action).unwrap();
    let exact = velocity(model("none").unwrap());
    let rounded = velocity(model("").unwrap().plain());
    let norm = |x: &Tensor| {
        let sum = x.sqr().unwrap().sum_all().unwrap();
        sum.to_scalar::<f32>().unwrap().sqrt()
    };
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
