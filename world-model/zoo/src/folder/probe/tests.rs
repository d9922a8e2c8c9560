use candle_core::{DType, Device, Tensor};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::super::tests::{adapted, folder};
use super::super::{DescribedFolder, FILE};
use super::*;
use crate::ModelFolder;
use crate::success_probe::{Reading, tests::TOKENIZER};

/// The model of the other tests, latents of 4x4x6, with a probe.
fn probed() -> Value {
    let mut model = adapted();
    model["probe"] = json!({
        "weights": "probe.safetensors",
        "config": {"features": 6, "max_frames": 4, "text_features": 16, "pool": 2, "hidden": 16, "depth": 2, "heads": 2,
                   "ffn": 20},
        "text": {"weights": "text.safetensors", "tokenizer": "tokenizer.json", "config": {
            "vocab_size": 12, "hidden_size": 16, "intermediate_size": 24, "num_hidden_layers": 1,
            "num_attention_heads": 2, "max_position_embeddings": 8}}
    });
    model
}

fn probed_folder(model: &Value) -> TempDir {
    let folder = folder(model);
    std::fs::write(folder.path().join("tokenizer.json"), TOKENIZER).unwrap();
    folder
}

fn classifier(model: &Value) -> SuccessClassifier {
    let folder = probed_folder(model);
    DescribedFolder::open(folder.path())
        .unwrap()
        .probe()
        .unwrap()
        .unwrap()
}

fn refused(model: &Value) -> String {
    let folder = probed_folder(model);
    DescribedFolder::open(folder.path())
        .unwrap_err()
        .to_string()
}

fn episode(frames: usize, phase: f32) -> Tensor {
    let values = (0..frames * 4 * 4 * 6).map(|i| (i as f32 * 0.7 + phase).sin());
    Tensor::from_iter(values, &Device::Cpu)
        .unwrap()
        .reshape((frames, 4, 4, 6))
        .unwrap()
}

#[test]
fn a_probability_is_of_the_episode_and_of_the_instruction() {
    let classifier = classifier(&probed());
    let [cup, plate] = ["put the cup", "put the plate"].map(|text| {
        let instruction = classifier.instruction(text).unwrap();
        assert_eq!(instruction.text(), text);
        instruction
    });
    let of = |phase, instruction| {
        classifier
            .probability(&episode(3, phase), instruction)
            .unwrap()
    };
    let found = [of(0.0, &cup), of(0.0, &plate), of(1.0, &cup)];
    assert!(found.iter().all(|p| (0.0..=1.0).contains(p)), "{found:?}");
    assert!((found[0] - found[1]).abs() > 1e-4, "{found:?}");
    assert!((found[0] - found[2]).abs() > 1e-4, "{found:?}");
    // Case is no other instruction.
    let shouted = classifier.instruction("PUT the Cup").unwrap();
    assert_eq!(of(0.0, &shouted), found[0]);
}

#[test]
fn the_probe_reads_no_padding_and_no_normalisation() {
    let model = probed();
    let folder = probed_folder(&model);
    let opened = DescribedFolder::open(folder.path()).unwrap();
    let classifier = opened.probe().unwrap().unwrap();
    let instruction = classifier.instruction("put the cup").unwrap();
    let found = classifier
        .probability(&episode(3, 0.0), &instruction)
        .unwrap();

    // By hand: latents scaled back, and of the text the three words and its end alone.
    let mut values = episode(3, 0.0).flatten_all().unwrap().to_vec1().unwrap();
    opened.normalisation.undo(&mut values);
    let latents = Tensor::from_vec(values, (1, 3, 4, 4, 6), &Device::Cpu).unwrap();
    let ids = Tensor::new(&[[3_u32, 4, 5, 1, 0, 0, 0, 0]], &Device::Cpu).unwrap();
    let Judge::Instructed(judge) = &classifier.judge else {
        panic!("another probe");
    };
    let Reader::Siglip { text, .. } = &judge.reader else {
        panic!("another reader");
    };
    let words = text.forward(&ids, None).unwrap();
    let words = Reading {
        features: words.narrow(1, 0, 4).unwrap(),
        mask: None,
    };
    let logit = judge.probe.forward(&latents, Some(&words)).unwrap();
    let logit = logit.to_vec1::<f32>().unwrap()[0];
    let expected = 1.0 / (1.0 + (-logit).exp());
    assert!((found - expected).abs() < 1e-6, "{found} {expected}");

    let mut plain = model;
    plain["normalisation"] = Value::Null;
    std::fs::write(folder.path().join(FILE), plain.to_string()).unwrap();
    let plain = DescribedFolder::open(folder.path())
        .unwrap()
        .probe()
        .unwrap();
    let unscaled = plain
        .unwrap()
        .probability(&latents.squeeze(0).unwrap(), &instruction);
    assert!((found - unscaled.unwrap()).abs() < 1e-6);
}

#[test]
fn a_probe_of_pooled_latents_reads_no_instruction() {
    for (kind, config) in [
        (
            "linear-probe",
            json!({"features": 6, "pool": 4, "max_frames": 4}),
        ),
        (
            "temporal-probe",
            json!({"features": 6, "max_frames": 4, "hidden": 16, "heads": 2, "mlp": 20}),
        ),
        (
            "progress-probe",
            json!({"features": 6, "pool": 2, "hidden": 16, "max_frames": 4}),
        ),
    ] {
        let mut model = adapted();
        model["probe"] = json!({"kind": kind, "weights": "probe.safetensors", "config": config});
        let folder = folder(&model);
        let opened = DescribedFolder::open(folder.path()).unwrap();
        let roles: Vec<_> = opened
            .summary()
            .unwrap()
            .parts
            .iter()
            .map(|p| p.role)
            .collect();
        assert_eq!(roles.last(), Some(&"probe"));
        let classifier = opened.probe().unwrap().unwrap();
        assert_eq!(classifier.max_frames(), 4, "{kind}");
        let [cup, plate] = ["cup", "plate"].map(|text| classifier.instruction(text).unwrap());
        let of = |phase, instruction| {
            let episode = episode(6, phase);
            classifier.probability(&episode, instruction).unwrap()
        };
        let found = of(0.0, &cup);
        assert!((0.0..=1.0).contains(&found), "{kind}: {found}");
        assert_eq!(found, of(0.0, &plate), "{kind}");
        assert!((found - of(1.0, &cup)).abs() > 1e-4, "{kind}: {found}");

        model["probe"]["text"] = probed()["probe"]["text"].clone();
        let message = refused(&model);
        assert!(message.contains("reads no instruction"), "{message}");
    }
    let mut model = probed();
    model["probe"].as_object_mut().unwrap().remove("text");
    let message = refused(&model);
    assert!(message.contains("probe: text: missing"), "{message}");
}

#[test]
fn of_a_long_episode_the_newest_frames_are_read() {
    let classifier = classifier(&probed());
    assert_eq!(classifier.max_frames(), 4);
    let instruction = classifier.instruction("put the cup").unwrap();
    let of = |episode: &Tensor| classifier.probability(episode, &instruction).unwrap();
    let (all, of_four) = (episode(6, 0.0), episode(4, 0.0));
    assert_eq!(of(&all), of(&all.narrow(0, 2, 4).unwrap()));
    assert_ne!(of(&all), of(&of_four), "the oldest are not");
    let wide = Tensor::zeros((2, 4, 4, 7), DType::F32, &Device::Cpu).unwrap();
    let message = classifier.probability(&wide, &instruction).unwrap_err();
    assert!(message.to_string().contains("latents"), "{message}");
}

#[test]
fn a_probe_that_does_not_fit_is_named() {
    let cases = [
        (
            json!(["config", "features", 7]),
            "probe: features is 7, but the encoder web-dino with the adapter on 32x32 gives latents of 6 channels",
        ),
        (
            json!(["config", "text_features", 17]),
            "probe: text_features is 17, but its text tower gives 16 (hidden_size)",
        ),
        (
            json!(["config", "pool", 0]),
            "probe: pool: 0, expected 1 to",
        ),
        (json!(["config", "layers", 1]), "unknown field `layers`"),
        (json!(["text", "tokenizer", "none.json"]), "probe.text: "),
        (
            json!(["text", "tokenizer", "none.json"]),
            "none.json: No such file",
        ),
    ];
    for (change, expected) in cases {
        let mut model = probed();
        let key = |i: usize| change[i].as_str().unwrap();
        model["probe"][key(0)][key(1)] = change[2].clone();
        let message = if expected.contains("expected") || expected.contains("unknown") {
            // Random weights cannot be made for it.
            let folder = probed_folder(&probed());
            std::fs::write(folder.path().join(FILE), model.to_string()).unwrap();
            DescribedFolder::open(folder.path())
                .unwrap_err()
                .to_string()
        } else {
            refused(&model)
        };
        assert!(message.contains("model.json"), "{message}");
        assert!(message.contains(expected), "{message}");
    }

    // Weights of another size are listed before a value is read.
    let folder = probed_folder(&probed());
    for (part, field, tensor) in [
        ("config", "depth", "blocks.2."),
        ("text", "num_hidden_layers", "layers.1."),
    ] {
        let mut model = probed();
        match part {
            "text" => model["probe"]["text"]["config"][field] = json!(2),
            _ => model["probe"][part][field] = json!(3),
        }
        std::fs::write(folder.path().join(FILE), model.to_string()).unwrap();
        let message = DescribedFolder::open(folder.path())
            .unwrap_err()
            .to_string();
        assert!(
            message.contains(tensor) && message.contains("missing"),
            "{message}"
        );
    }
}

#[test]
fn a_wrong_tokenizer_is_named_where_the_probe_is_loaded() {
    let folder = probed_folder(&probed());
    let path = folder.path().join("tokenizer.json");
    std::fs::write(&path, "{}").unwrap();
    // Who does not need the probe does not read it.
    let model = ModelFolder::open(&folder.path().to_string_lossy()).unwrap();
    model.encoder().unwrap();
    let message = model.probe().unwrap_err().to_string();
    let file = path.display().to_string();
    assert!(message.starts_with(&file), "{message}");
    assert!(message.contains("not a tokenizer.json"), "{message}");
}

#[test]
fn the_embedded_probe_reads_the_simulators_instructions() {
    let probe = ModelFolder::open("tiny").unwrap().probe().unwrap().unwrap();
    probe
        .instruction("put the white box to the right of the purple box")
        .unwrap();
    let error = probe
        .instruction("put the towel in the bowl")
        .unwrap_err()
        .to_string();
    assert!(error.contains("towel"), "{error}");
}

#[test]
fn a_model_need_not_have_a_probe() {
    let without = folder(&adapted());
    let without = DescribedFolder::open(without.path()).unwrap();
    assert!(without.probe().unwrap().is_none());
    let with = probed_folder(&probed());
    let with = DescribedFolder::open(with.path()).unwrap();
    let roles = |model: &DescribedFolder| -> Vec<_> {
        let parts = model.summary().unwrap().parts;
        parts.iter().map(|part| part.role).collect()
    };
    let (with_roles, without_roles) = (roles(&with), roles(&without));
    assert_eq!(
        with_roles,
        [without_roles, vec!["probe's text", "probe"]].concat()
    );
    // A probe is no part of the latents' space, nor of the dynamics.
    assert_eq!(with.space().unwrap(), without.space().unwrap());
}
