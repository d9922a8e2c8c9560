use candle_core::{DType, Device};
use safetensors::tensor::{Dtype, TensorView};
use wm_model::random;
use wm_model::sampler::Sampler;
use wm_model::transition::{Initialisation, Parameter, Transition};

use super::*;

const CONFIG: &str = r#"{"hidden": 32, "depth": 2, "heads": 2, "channels": 4, "patch": 2, "grid": [4, 6],
    "action_dim": 5, "max_frames": 4, "head": "wide", "wide_dim": 48}"#;

/// A checkpoint of a transition model with random weights, under `prefix`.
fn checkpoint(prefix: &str) -> Checkpoint {
    let config: DitConfig = parse(CONFIG).unwrap();
    let mut tensors = Vec::new();
    Transition::build(config.transition().unwrap(), &mut |p| {
        let parameter = Parameter {
            initialisation: Initialisation::Normal(0.1),
            ..p.clone()
        };
        let tensor = parameter.initial(1)?;
        let values = tensor.flatten_all()?.to_vec1::<f32>()?;
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        tensors.push((format!("{prefix}{}", p.name), p.shape.clone(), bytes));
        Ok(tensor)
    })
    .unwrap();
    let views = tensors.iter().map(|(name, shape, bytes)| {
        (
            name,
            TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap(),
        )
    });
    Checkpoint::from_bytes("test", safetensors::serialize(views, None).unwrap()).unwrap()
}

fn random(shape: &[usize], seed: u64) -> Tensor {
    random::normal(shape, seed).unwrap()
}

fn tensors(items: &[(&str, Tensor)]) -> Tensors {
    let own = |(name, tensor): &(&str, Tensor)| ((*name).to_owned(), tensor.clone());
    items.iter().map(own).collect()
}

fn most(a: &Tensor, b: &Tensor) -> f32 {
    let difference = (a - b).unwrap().abs().unwrap();
    difference.max_all().unwrap().to_scalar().unwrap()
}

#[test]
fn names_are_read_back() {
    for kind in Kind::ALL {
        assert_eq!(kind.to_string().parse::<Kind>().unwrap(), *kind);
    }
    let message = "vae".parse::<Kind>().unwrap_err().to_string();
    assert!(
        message.contains("`vae`") && message.contains("sd3-vae-decoder"),
        "{message}"
    );
}

#[test]
fn a_transition_model_is_found_in_its_wrappers() {
    let inputs = tensors(&[
        ("x", random(&[2, 3, 4, 6, 4], 1)),
        ("tau", random::uniform(&[2, 3], 2).unwrap()),
        ("action", random(&[2, 3, 5], 3)),
    ]);
    let run = |checkpoint: &Checkpoint| {
        forward(Kind::Dit, CONFIG, checkpoint, &inputs, &Compute::default()).unwrap()
    };
    let plain = run(&checkpoint(""));
    assert_eq!(plain["velocity"].dims(), [2, 3, 4, 6, 4]);
    for prefix in ["ema.module._orig_mod.", "state_dict.module."] {
        let wrapped = run(&checkpoint(prefix));
        assert_eq!(most(&plain["velocity"], &wrapped["velocity"]), 0.0);
    }
}

#[test]
fn a_rollout_with_the_cache_equals_the_definition() {
    let checkpoint = checkpoint("");
    for observed in [1, 2, 5] {
        let predicted = 4;
        let inputs = tensors(&[
            ("context", random(&[2, observed, 4, 6, 4], 1)),
            ("actions", random(&[2, observed + predicted, 5], 2)),
            ("noise", random(&[2, predicted, 4, 6, 4], 3)),
        ]);
        let run = |cache| {
            let options = RolloutOptions {
                sampler: Sampler {
                    steps: 3,
                    shift: 2.0,
                    context_tau: 0.01,
                },
                cache,
            };
            let out = rollout(CONFIG, &checkpoint, &inputs, &options, &Compute::default());
            out.unwrap()["predicted"].clone()
        };
        let (cached, plain) = (run(true), run(false));
        assert_eq!(cached.dims(), [2, predicted, 4, 6, 4]);
        assert!(most(&cached, &plain) < 1e-4, "{}", most(&cached, &plain));
    }
}

#[test]
fn what_is_missing_is_named() {
    let checkpoint = checkpoint("");
    let inputs = tensors(&[("x", random(&[1, 1, 4, 6, 4], 1))]);
    let run = |config: &str, kind| {
        let out = forward(kind, config, &checkpoint, &inputs, &Compute::default());
        out.unwrap_err().to_string()
    };
    let message = run(CONFIG, Kind::Dit);
    assert!(
        message.contains("`tau`") && message.contains("there are: x"),
        "{message}"
    );
    let message = run(&CONFIG.replace("hidden", "width"), Kind::Dit);
    assert!(message.contains("width"), "{message}");
    let message = run(&CONFIG.replace("\"depth\": 2", "\"depth\": 3"), Kind::Dit);
    assert!(
        message.contains("blocks.2.s_block.attn.qkv_proj.weight [96, 32]"),
        "{message}"
    );
    let message = run(&CONFIG.replace("\"depth\": 2", "\"depth\": 1"), Kind::Dit);
    let expected = "unexpected (18):\n  blocks.1.s_block.adaLN_modulation.1.bias";
    assert!(message.contains(expected), "{message}");
}

#[test]
fn an_input_that_cannot_be_computed_with_is_named() {
    let checkpoint = checkpoint("");
    let good = tensors(&[
        ("x", random(&[2, 3, 4, 6, 4], 1)),
        ("tau", Tensor::full(0.5f32, (2, 3), &Device::Cpu).unwrap()),
        ("action", random(&[2, 3, 5], 2)),
    ]);
    let zeros = |shape: &[usize]| Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap();
    let nan = (random(&[2, 3, 5], 3) * f64::NAN).unwrap();
    for (name, tensor, expected) in [
        (
            "x",
            zeros(&[2, 0, 4, 6, 4]),
            "`x` of shape [2, 0, 4, 6, 4] is empty",
        ),
        ("action", nan, "`action` has a value that is not finite"),
        (
            "tau",
            (zeros(&[2, 3]) + 500.0).unwrap(),
            "`tau` has a value 500, expected 0 to 1",
        ),
        (
            "x",
            zeros(&[2, 3, 4, 6, 3]),
            "[2, 3, 4, 6, 3], expected (B, T, 4, 6, 4)",
        ),
    ] {
        let mut inputs = good.clone();
        inputs.insert(name.to_owned(), tensor);
        let out = forward(Kind::Dit, CONFIG, &checkpoint, &inputs, &Compute::default());
        let message = out.unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn the_plain_head_takes_any_wide_dim() {
    for wide in ["", r#", "wide_dim": null"#, r#", "wide_dim": 7"#] {
        let json = format!(
            r#"{{"hidden": 16, "depth": 1, "heads": 1, "channels": 3, "patch": 1, "grid": [3, 4],
                "action_dim": 7, "head": "plain"{wide}}}"#
        );
        let config: DitConfig = parse(&json).unwrap();
        assert_eq!(config.transition().unwrap().wide_head, None);
    }
    let config: DitConfig = parse(&CONFIG.replace(", \"wide_dim\": 48", "")).unwrap();
    assert_eq!(config.transition().unwrap().wide_head, Some(2048));
}
