use candle_core::{DType, Device, Tensor};
use serde_json::{Value, json};
use tempfile::TempDir;
use wm_model::random;
use wm_model::sampler::Rollout;
use wm_model::trained_folder::TRANSITION_FILE;
use wm_model::transition::{ACTIONS_KEY, CONFIG_KEY, LATENT_SPACE_KEY, Transition};
use wm_model::weights::{Precision as Stored, WeightsBuilder};
use wm_model::{Fit, Framing, Kernels};
use wm_motion::actions::Accumulation;

use super::*;
use crate::ModelFolder;

mod calibrated;

/// Web-DINO of one layer on 28x28, an S-VAE, a pixel decoder and a DiT: latents of 4x4x6.
pub(super) fn adapted() -> Value {
    json!({
        "name": "small-6",
        "image": [32, 32],
        "encoder": {"kind": "web-dino", "weights": "encoder.safetensors", "config": {
            "hidden_size": 48, "num_hidden_layers": 1, "num_attention_heads": 4, "image_size": 28, "patch_size": 7}},
        "adapter": {"kind": "svae", "weights": "svae.safetensors", "config": {
            "features": 48, "latent": 6, "heads": 4, "layers": 1, "ffn": 16}},
        "normalisation": {"mean": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], "std": [1.0, 2.0, 1.0, 2.0, 1.0, 2.0]},
        "decoder": {"kind": "pixel", "weights": "svae.safetensors", "config": {
            "latent": 6, "base": 32, "multipliers": [1, 1], "res_blocks": 1, "heads": 2}},
        "transition": {
            "config": {"hidden": 32, "depth": 1, "heads": 2, "channels": 6, "patch": 1, "grid": [4, 4], "action_dim": 10},
            "weights": "dit.safetensors",
            "actions": {"frame_skip": 3},
            "sampler": {"steps": 2, "shift": 1.5, "context_tau": 0.01}
        }
    })
}

/// The same without adapter: native latents of 4x4x48, decoded through the adapter.
fn native() -> Value {
    let mut model = adapted();
    model["name"] = json!("small-48");
    model["decoder"]["adapter"] = model["adapter"].take();
    model["normalisation"] = Value::Null;
    model["transition"]["config"]["channels"] = json!(48);
    model
}

pub(super) fn folder(model: &Value) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(FILE), model.to_string()).unwrap();
    write_random_weights(folder.path(), 7).unwrap();
    folder
}

fn refused(model: &Value) -> String {
    let folder = folder(model);
    DescribedFolder::open(folder.path())
        .unwrap_err()
        .to_string()
}

fn space_of(folder: &TempDir, model: &Value) -> LatentSpace {
    std::fs::write(folder.path().join(FILE), model.to_string()).unwrap();
    DescribedFolder::open(folder.path())
        .unwrap()
        .space()
        .unwrap()
}

#[test]
fn a_folder_encodes_predicts_and_decodes_in_one_space() {
    for (model, latent) in [(adapted(), (4, 4, 6)), (native(), (4, 4, 48))] {
        let folder = folder(&model);
        let model = ModelFolder::open(&folder.path().to_string_lossy()).unwrap();
        let encoder = model.encoder().unwrap();
        assert_eq!(encoder.space().shape(), latent);
        assert_eq!(encoder.input_size(), (32, 32));
        let images = random::uniform(&[2, 32, 32, 3], 1).unwrap();
        let latents = encoder.encode(&images).unwrap();
        assert_eq!(latents.dims(), [2, latent.0, latent.1, latent.2]);

        let world_model = model.world_model().unwrap();
        assert_eq!(&world_model.space, encoder.space());
        let config = world_model.transition.config();
        assert_eq!(
            (
                config.frame_skip,
                config.sampler.steps,
                config.sampler.shift
            ),
            (3, 2, 1.5)
        );
        assert_eq!(world_model.encoding.action_dim(), 10);
        let between = Tensor::zeros((1, 10), DType::F32, &Device::Cpu).unwrap();
        let context = latents.unsqueeze(0).unwrap();
        let sampler = &config.sampler;
        let mut rollout = Rollout::new(
            &world_model.transition,
            sampler,
            &context,
            Some(&between),
            1,
        )
        .unwrap();
        let next = rollout.next(&between).unwrap();

        let decoder = model.decoder().unwrap().unwrap();
        assert_eq!(decoder.space(), encoder.space());
        assert_eq!(decoder.output_size(), (8, 8));
        assert_eq!(decoder.decode(&next).unwrap().dims(), [1, 8, 8, 3]);
    }
}

/// What `model` makes of two pictures: their latents, what three candidates predict after them, and its pictures.
fn through(model: &ModelFolder) -> [Tensor; 3] {
    let decoder = model.decoder().unwrap().unwrap();
    pass(
        &*model.encoder().unwrap(),
        &model.world_model().unwrap(),
        &*decoder,
    )
}

/// The same of its parts.
fn pass(encoder: &dyn Encoder, model: &WorldModel, decoder: &dyn Decoder) -> [Tensor; 3] {
    let (height, width) = encoder.input_size();
    let wave = |count: usize| (0..count).map(|i| (i as f32 * 0.37).sin() / 2.0 + 0.5);
    let tensor = |shape: &[usize]| {
        let values: Vec<f32> = wave(shape.iter().product()).collect();
        Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
    };
    let latents = encoder.encode(&tensor(&[2, height, width, 3])).unwrap();
    let WorldModel { transition, .. } = model;
    let (sampler, actions) = (&transition.config().sampler, transition.config().action_dim);
    let context = latents.unsqueeze(0).unwrap();
    let between = tensor(&[1, actions]);
    let rollout = Rollout::new(transition, sampler, &context, Some(&between), 1).unwrap();
    let mut candidates = rollout.candidates(3).unwrap();
    for _ in 0..3 {
        candidates.next(&tensor(&[3, actions])).unwrap();
    }
    let predicted = candidates.next(&tensor(&[3, actions])).unwrap();
    let pictures = decoder.decode(&predicted).unwrap();
    [latents, predicted, pictures]
}

/// The first GPU, with recorded passes and without, in a build for it.
fn gpus() -> Vec<Compute> {
    let gpu: Compute = "cuda".parse().unwrap();
    match gpu.device() {
        Ok(_) => vec![gpu.clone(), gpu.recording(true)],
        Err(missing) => {
            eprintln!("GPU: skipped, {missing}");
            vec![]
        }
    }
}

/// Of the embedded model and of folders with and without an adapter, in both number formats.
#[test]
fn what_a_gpu_would_compute_is_what_the_kernels_do() {
    let mut folders = vec![];
    for dtype in ["f32", "bf16"] {
        for mut model in [adapted(), native()] {
            model["dtype"] = dtype.into();
            folders.push(folder(&model));
        }
    }
    let names = folders
        .iter()
        .map(|f| f.path().to_string_lossy().into_owned());
    for name in names.chain(["tiny".to_owned()]) {
        let on = |compute| through(&ModelFolder::open(&name).unwrap().on(compute));
        let kernels = on(Compute::default());
        // The code of a GPU runs on the CPU too.
        let rehearsed = Compute::on_cpu(Kernels::Candle).recording(true);
        for compute in gpus().into_iter().chain([rehearsed]) {
            let tensors = on(compute.clone());
            for ((what, found), expected) in ["latents", "predicted", "pictures"]
                .into_iter()
                .zip(&tensors)
                .zip(&kernels)
            {
                assert_eq!((found.dims(), found.dtype()), (expected.dims(), DType::F32));
                let norm = |x: &Tensor| -> f32 {
                    let squares = x.sqr().unwrap().sum_all().unwrap();
                    squares.to_scalar::<f32>().unwrap().sqrt()
                };
                let difference = norm(&(found - expected).unwrap()) / norm(expected);
                // Both have bf16 weights as f32 here; kernels round activations to them where the processor has such products.
                assert!(difference < 2e-2, "{name}, {what}, {compute}: {difference}");
                println!("{name}, {what}, {compute}: {difference:.1e}");
            }
        }
    }
}

#[test]
fn an_adapter_decodes_to_the_space_of_its_encoder_alone() {
    let folder = folder(&adapted());
    let open = || DescribedFolder::open(folder.path()).unwrap();
    let (adapter, encoder) = (
        open().native_decoder().unwrap().unwrap(),
        open().encoder(&Compute::default()),
    );
    let images = random::uniform(&[2, 32, 32, 3], 1).unwrap();
    let latents = encoder.unwrap().encode(&images).unwrap();
    let features = adapter.decode(&latents).unwrap();
    assert_eq!(features.dims(), [2, 4, 4, 48]);
    // By the adapter's own round trip of the encoder's features.
    let compute = Compute::default();
    let svae = load_adapter(open().adapter.as_ref(), &compute, &KnownInputs::Nothing)
        .unwrap()
        .unwrap();

    // The transition's weights are of the adapter's latents.
    let mut encoder_alone = native();
    encoder_alone.as_object_mut().unwrap().remove("transition");
    let space = space_of(&folder, &encoder_alone);
    assert_eq!(adapter.native().hash, space.hash);
    assert_eq!(adapter.native().shape(), space.shape());
    assert!(open().native_decoder().unwrap().is_none());
    let own = svae.forward(
        &open()
            .encoder(&Compute::default())
            .unwrap()
            .encode(&images)
            .unwrap(),
    );
    let values = |x: &Tensor| x.flatten_all().unwrap().to_vec1::<f32>().unwrap();
    for (a, b) in values(&features).iter().zip(values(&own.unwrap())) {
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }
    let wrong = adapter.decode(&features).unwrap_err().to_string();
    assert!(wrong.contains("(N, 4, 4, 6)"), "{wrong}");
}

/// A model whose transition the training is still to write encodes and decodes; the file beside it is then taken, if it
/// was trained on these latents.
#[test]
fn a_transition_may_be_trained_later() {
    let mut model = adapted();
    model.as_object_mut().unwrap().remove("transition");
    let folder = folder(&model);
    let open = || ModelFolder::open(&folder.path().to_string_lossy()).unwrap();
    let encoder = open().encoder().unwrap();
    assert!(!open().has_transition() && open().decoder().unwrap().is_some());
    let error = open().world_model().unwrap_err().to_string();
    assert!(error.contains("wm train transition"), "{error}");

    let space = encoder.space().clone();
    let config = TransitionConfig {
        hidden: 32,
        depth: 1,
        heads: 2,
        ..TransitionConfig::preset("tiny", space.shape(), 2, 7).unwrap()
    };
    let write = |space: &LatentSpace| {
        let mut weights = WeightsBuilder::new();
        let mut source = |parameter: &wm_model::transition::Parameter| {
            let tensor = parameter.initial(3)?;
            weights.tensor(&parameter.name, &tensor, Stored::F16)?;
            Ok(tensor)
        };
        Transition::build(config.clone(), &mut source).unwrap();
        weights.metadata(CONFIG_KEY, json!(config).to_string());
        weights.metadata(ACTIONS_KEY, json!(ActionEncoding::default()).to_string());
        weights.metadata(LATENT_SPACE_KEY, json!(space).to_string());
        weights.write(folder.path().join(TRANSITION_FILE)).unwrap();
    };
    write(&space);
    let world_model = open().world_model().unwrap();
    assert_eq!(world_model.space, space);
    assert_eq!(world_model.transition.config(), &config);
    assert_eq!(world_model.encoding, ActionEncoding::default());

    write(&LatentSpace {
        name: "another".into(),
        hash: "1".into(),
        ..space
    });
    let error = open().world_model().unwrap_err().to_string();
    assert!(error.contains("another"), "{error}");
}

#[test]
fn decoding_undoes_the_normalisation() {
    let (with, mut without) = (adapted(), adapted());
    without["normalisation"] = Value::Null;
    let open = |model| {
        let folder = folder(model);
        let model = DescribedFolder::open(folder.path()).unwrap();
        (
            model.encoder(&Compute::default()).unwrap(),
            model.decoder(&Compute::default()).unwrap().unwrap(),
        )
    };
    let ((encoder, decoder), (plain_encoder, plain_decoder)) = (open(&with), open(&without));
    let image = random::uniform(&[1, 32, 32, 3], 1).unwrap();
    let (latent, plain) = (
        encoder.encode(&image).unwrap(),
        plain_encoder.encode(&image).unwrap(),
    );
    let channel = |x: &Tensor, c| x.get(0).unwrap().to_vec3::<f32>().unwrap()[1][2][c];
    assert!((channel(&latent, 3) - (channel(&plain, 3) - 0.4) / 2.0).abs() < 1e-5);
    let difference = (decoder.decode(&latent).unwrap() - plain_decoder.decode(&plain).unwrap())
        .unwrap()
        .abs()
        .unwrap()
        .max_all()
        .unwrap();
    assert!(difference.to_scalar::<f32>().unwrap() < 1e-4);
}

#[test]
fn the_space_is_that_of_encoder_adapter_and_normalisation() {
    let model = adapted();
    let folder = folder(&model);
    let space = space_of(&folder, &model);
    assert_eq!((space.name.as_str(), space.hash.len()), ("small-6", 64));

    // Neither what decodes nor what predicts is part of it, nor whether a default is written out.
    let mut same = model.clone();
    same["decoder"] = Value::Null;
    same["transition"]["sampler"]["steps"] = json!(5);
    same["encoder"]["config"]["qkv_bias"] = json!(true);
    assert_eq!(space_of(&folder, &same), space);

    let mut other = model.clone();
    other["normalisation"]["mean"][2] = json!(0.31);
    assert_ne!(space_of(&folder, &other).hash, space.hash);
    let mut other = model.clone();
    other["dtype"] = json!("bf16");
    assert_ne!(space_of(&folder, &other).hash, space.hash);
    let mut other = model.clone();
    other["encoder"]["config"]["layer_norm_eps"] = json!(1e-5);
    assert_ne!(space_of(&folder, &other).hash, space.hash);

    let svae = folder.path().join("svae.safetensors");
    std::fs::remove_file(&svae).unwrap();
    write_random_weights(folder.path(), 8).unwrap();
    assert_ne!(space_of(&folder, &model).hash, space.hash);
    std::fs::remove_file(&svae).unwrap();
    write_random_weights(folder.path(), 7).unwrap();
    assert_eq!(space_of(&folder, &model), space);
}

#[test]
fn the_fit_is_described_and_part_of_the_space_unless_stretch() {
    let mut model = adapted();
    let folder = folder(&model);
    let without = space_of(&folder, &model);
    model["fit"] = json!("stretch");
    assert_eq!(space_of(&folder, &model), without);
    model["fit"] = json!("crop");
    model["trained_on"] = json!({"width": 640, "height": 480});
    assert_ne!(space_of(&folder, &model).hash, without.hash);
    let opened = ModelFolder::open(&folder.path().to_string_lossy()).unwrap();
    let expected = Framing::new((32, 32), Fit::Crop);
    assert_eq!(opened.encoder().unwrap().framing(), expected);
    assert_eq!(opened.framing().unwrap(), expected);
    assert_eq!(opened.fit().unwrap(), Fit::Crop);
    let trained_on = opened.trained_on().unwrap().unwrap();
    assert_eq!(trained_on.to_string(), "640x480");
    model["fit"] = json!("squeeze");
    let error = serde_json::from_value::<Description>(model).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("squeeze") && error.contains("crop"),
        "{error}"
    );
}

#[test]
fn the_embedded_model_and_old_folders_stretch() {
    let tiny = ModelFolder::open(wm_model::trained_folder::EMBEDDED).unwrap();
    assert_eq!(tiny.fit().unwrap(), Fit::Stretch);
    assert_eq!(tiny.trained_on().unwrap().unwrap().to_string(), "256x256");
    let folder = folder(&adapted());
    let old = ModelFolder::open(&folder.path().to_string_lossy()).unwrap();
    let framing = old.encoder().unwrap().framing();
    assert_eq!(framing, Framing::from((32, 32)));
    assert_eq!(old.trained_on().unwrap(), None);
}

#[test]
fn views_lie_beside_each_other() {
    let mut model = adapted();
    model["transition"]["config"]["views"] = json!(2);
    model["transition"]["config"]["grid"] = json!([4, 8]);
    let folder = folder(&model);
    let model = DescribedFolder::open(folder.path()).unwrap();
    let encoder = model.encoder(&Compute::default()).unwrap();
    assert_eq!(encoder.input_size(), (32, 64));
    assert_eq!(model.framing(), encoder.framing());
    assert_eq!(model.framing().views, 2);
    assert_eq!(encoder.space().shape(), (4, 8, 6));
    let image = random::uniform(&[1, 32, 64, 3], 1).unwrap();
    let latent = encoder.encode(&image).unwrap();
    // Each view is encoded as if it were alone.
    let swapped = |x: &Tensor, half| {
        let halves = [
            x.narrow(2, half, half).unwrap(),
            x.narrow(2, 0, half).unwrap(),
        ];
        Tensor::cat(&halves, 2).unwrap()
    };
    let of_swapped = encoder.encode(&swapped(&image, 32)).unwrap();
    let difference = (swapped(&latent, 4) - of_swapped).unwrap().abs().unwrap();
    let most = difference.max_all().unwrap().to_scalar::<f32>().unwrap();
    assert!(most < 1e-5, "{most}");
    let decoder = model.decoder(&Compute::default()).unwrap().unwrap();
    assert_eq!(decoder.decode(&latent).unwrap().dims(), [1, 8, 16, 3]);
}

#[test]
fn positions_of_several_views_are_part_of_the_models_hash() {
    let mut model = adapted();
    model["transition"]["config"]["views"] = json!(2);
    model["transition"]["config"]["grid"] = json!([4, 8]);
    let folder = folder(&model);
    let mut transition = |layout: Option<&str>| {
        if let Some(layout) = layout {
            model["transition"]["config"]["rope_layout"] = json!(layout);
        }
        std::fs::write(folder.path().join(FILE), model.to_string()).unwrap();
        let opened = DescribedFolder::open(folder.path()).unwrap();
        opened.world_model(&Compute::default()).unwrap()
    };
    let default = transition(None);
    let [reference, by_view] = ["reference", "by_view"].map(|layout| transition(Some(layout)));
    assert_eq!(default.hash, reference.hash);
    assert_ne!(default.hash, by_view.hash);
    // A latent space says how views are encoded, not how the transition numbers them.
    assert_eq!(default.space, by_view.space);

    let x = random::uniform(&[1, 2, 4, 8, 6], 1).unwrap();
    let tau = Tensor::new(&[[0f32, 0.5]], &Device::Cpu).unwrap();
    let action = Tensor::zeros((1, 2, 10), DType::F32, &Device::Cpu).unwrap();
    let [default, reference, by_view] = [default, reference, by_view].map(|model| {
        let velocity = model.transition.forward(&x, &tau, &action).unwrap();
        velocity.flatten_all().unwrap().to_vec1::<f32>().unwrap()
    });
    assert_eq!(default, reference);
    assert_ne!(default, by_view);
}

#[test]
fn of_a_steps_actions_the_first_is_taken_as_in_the_reference() {
    let mut model = adapted();
    for (actions, expected) in [
        (None, Accumulation::Index),
        (Some(json!({"frame_skip": 3})), Accumulation::Index),
        (Some(json!({"accumulation": "mean"})), Accumulation::Mean),
    ] {
        match actions {
            Some(actions) => model["transition"]["actions"] = actions,
            None => drop(
                model["transition"]
                    .as_object_mut()
                    .unwrap()
                    .remove("actions"),
            ),
        }
        let folder = folder(&model);
        let transition = DescribedFolder::open(folder.path())
            .unwrap()
            .world_model(&Compute::default());
        assert_eq!(transition.unwrap().encoding.accumulation(), expected);
    }
}

#[test]
fn parts_that_do_not_fit_are_named_on_both_sides() {
    let mut model = adapted();
    model["transition"]["config"]["channels"] = json!(7);
    let message = refused(&model);
    for part in [
        "model.json",
        "the transition takes latents of 4x4x7",
        "web-dino with the adapter on 32x32 gives 4x4x6",
    ] {
        assert!(message.contains(part), "{message}");
    }

    let mut model = native();
    model["transition"]["config"]["grid"] = json!([4, 6]);
    let message = refused(&model);
    assert!(
        message.contains("of 4x6x48") && message.contains("gives 4x4x48"),
        "{message}"
    );

    let mut model = adapted();
    model["adapter"]["config"]["features"] = json!(52);
    let message = refused(&model);
    assert!(
        message.contains("takes features of 52 channels, the encoder gives 48"),
        "{message}"
    );

    let mut model = native();
    model["decoder"]["adapter"] = Value::Null;
    let message = refused(&model);
    assert!(
        message.contains("the decoder pixel takes latents of 6 channels")
            && message.contains("without an adapter on 32x32 gives 48"),
        "{message}"
    );
}

#[test]
fn what_is_wrong_in_a_part_is_named_with_the_part() {
    let cases = [
        (
            ("encoder", "kind"),
            json!("pixel"),
            "encoder: kind: `pixel` is no encoder",
        ),
        (
            ("adapter", "kind"),
            json!("dit"),
            "adapter: kind: `dit` is no adapter",
        ),
        (("encoder", "config"), json!("none.json"), "none.json"),
        (
            ("transition", "actions"),
            json!({"action_dim": 7}),
            "transition: actions: action_dim 7, expected 10",
        ),
        (
            ("transition", "actions"),
            json!({"frame_skip": 0}),
            "frame_skip is 0; expected 1 to 1000",
        ),
        (
            ("normalisation", "std"),
            json!([1.0]),
            "normalisation: normalisation: 6 means and 1",
        ),
    ];
    for ((part, field), value, expected) in cases {
        let folder = folder(&adapted());
        let mut model = adapted();
        model[part][field] = value;
        std::fs::write(folder.path().join(FILE), model.to_string()).unwrap();
        let message = DescribedFolder::open(folder.path())
            .unwrap_err()
            .to_string();
        assert!(message.contains(expected), "{message}");
    }

    let folder = folder(&adapted());
    std::fs::remove_file(folder.path().join("dit.safetensors")).unwrap();
    let message = DescribedFolder::open(folder.path())
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("transition: ") && message.contains("dit.safetensors"),
        "{message}"
    );

    // Weights of another size: every tensor is named before a value is read.
    let mut model = adapted();
    model["encoder"]["config"]["num_hidden_layers"] = json!(2);
    std::fs::write(folder.path().join(FILE), model.to_string()).unwrap();
    let message = DescribedFolder::open(folder.path())
        .unwrap_err()
        .to_string();
    assert!(message.contains("encoder.layer.1.attention"), "{message}");
}

#[test]
fn a_model_need_not_decode() {
    let mut model = adapted();
    model["decoder"] = Value::Null;
    let folder = folder(&model);
    let model = DescribedFolder::open(folder.path()).unwrap();
    assert!(model.decoder(&Compute::default()).unwrap().is_none());
    let summary = model.summary().unwrap();
    let roles: Vec<_> = summary.parts.iter().map(|part| part.role).collect();
    assert_eq!(roles, ["encoder", "adapter", "transition"]);
    let frame_skip = summary.stepping.map(|stepping| stepping.frame_skip);
    assert_eq!((summary.latent, frame_skip), ([4, 4, 6], Some(3)));
}
