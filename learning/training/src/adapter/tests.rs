use std::path::Path;

use candle_core::{DType, Tensor};
use serde::Deserialize;
use serde_json::{Value, json};
use wm_dataset::{Dataset, Latents};
use wm_model::{Encoder, LatentSpace, transition::WeightGradients};
use wm_zoo::{
    ModelFolder, PixelDecoderConfig, SvaeConfig,
    folder::{DescribedFolder, write_random_weights},
};

use super::{arguments::train_on, frames::View, *};
use crate::{
    arguments::tests::on_cpu,
    arguments::tests::run_in,
    autoencoder::tests::dataset,
    optimiser::Variables,
    recipe::{Span, tests::bundled},
    run::{Learner as _, Stop, tests::expect_same_bytes_after_pause},
};

const SIDE: usize = 16;
const GRID: usize = 4;
const FEATURES: usize = 16;

/// A random matrix on patches of 4x4 pixels.
struct RandomPatches(LatentSpace);

impl RandomPatches {
    fn new() -> Self {
        Self(LatentSpace {
            name: "patches".into(),
            hash: "patches".into(),
            height: GRID,
            width: GRID,
            channels: FEATURES,
        })
    }
}

impl Encoder for RandomPatches {
    fn space(&self) -> &LatentSpace {
        &self.0
    }

    fn input_size(&self) -> (usize, usize) {
        (SIDE, SIDE)
    }

    fn encode(&self, images: &Tensor) -> wm_model::Result<Tensor> {
        let (n, k) = (images.dim(0)?, SIDE / GRID);
        let patches = images
            .reshape((n, GRID, k, GRID, k * 3))?
            .transpose(2, 3)?
            .contiguous()?;
        let weight: Vec<f32> = (0..k * k * 3 * FEATURES)
            .map(|i| (i as f32 * 12.9898).sin())
            .collect();
        let weight = Tensor::from_vec(weight, (k * k * 3, FEATURES), &Device::Cpu)?;
        let patches = patches.reshape((n * GRID * GRID, k * k * 3))?;
        Ok(patches
            .affine(2.0, -1.0)?
            .matmul(&weight)?
            .affine(0.2, 0.0)?
            .reshape((n, GRID, GRID, FEATURES))?)
    }
}

fn encoded(scratch: &Path) -> (Dataset, Latents) {
    let dataset = dataset(scratch, false);
    let latents = Latents::open(&dataset, &RandomPatches::new(), &scratch.join("cache")).unwrap();
    (dataset, latents)
}

fn data((dataset, latents): &(Dataset, Latents)) -> Data<'_> {
    let frames = Frames::new(dataset, latents).unwrap();
    Data {
        train: frames,
        held_out: Some(frames),
        lpips: None,
        start: None,
        description: None,
    }
}

/// A small recipe for these frames.
fn small(name: &str, others: &[&str]) -> AdapterRecipe {
    let settings = [
        "batch=4",
        "micro_batch=2",
        "model.latent=6",
        "model.heads=2",
        "model.layers=1",
        "model.ffn=24",
        "model.base=8",
        "model.multipliers=[1,1,2]",
        "model.res_blocks=1",
        "model.pixel_heads=2",
        "loss.perceptual_after=0",
    ];
    bundled(name, &[&settings, others].concat())
}

fn trained(recipe: &AdapterRecipe, data: &Data<'_>, out: &Path) {
    train_on(&run_in(out), recipe, data, json!({}), &Stop::default()).unwrap();
}

fn journal(out: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(out.join("adapter.journal.jsonl")).unwrap();
    let lines = text.lines().map(|line| serde_json::from_str(line).unwrap());
    lines.collect()
}

#[test]
fn training_learns_features_and_pictures() {
    let scratch = tempfile::tempdir().unwrap();
    let encoded = encoded(scratch.path());
    let out = scratch.path().join("run");
    let recipe = small(
        "tiny",
        &[
            "length=300 steps",
            "validate_every=10",
            "optimisation.learning_rate=3e-3",
            "optimisation.warm_up=5 steps",
            "optimisation.ema_decay=0.9",
        ],
    );
    trained(&recipe, &data(&encoded), &out);
    let journal = journal(&out);
    let of = |line: &Value, name: &str| line["validation"][name].as_f64().unwrap();
    let mut validations = journal.iter().filter(|line| line["validation"].is_object());
    let (first, last) = (
        validations.next().unwrap(),
        validations.next_back().unwrap(),
    );
    println!("{first} then {last}");
    let cosine = of(last, "feature_cosine");
    assert!(
        cosine > 0.9 && cosine > of(first, "feature_cosine"),
        "{last}"
    );
    assert!(
        of(last, "feature_mse") < 0.5 * of(first, "feature_mse"),
        "{last}"
    );
    assert!(of(last, "psnr") > of(first, "psnr") + 6.0, "{last}");
    let step = journal.iter().find(|line| line["step"] == 299).unwrap();
    for part in ["feature_spectrum", "kl", "pixel_mse", "ms_ssim_loss"] {
        assert!(step[part].is_number(), "{part}: {step}");
    }
    assert!(step["lpips"].is_null(), "{step}");
    let samples = image::open(out.join("adapter.samples/step_0000300.png")).unwrap();
    assert_eq!((samples.width(), samples.height()), (48, 16 * 6));
}

#[test]
fn paused_training_gives_the_same_bytes() {
    let scratch = tempfile::tempdir().unwrap();
    let encoded = encoded(scratch.path());
    let data = data(&encoded);
    for name in ["tiny", "paper"] {
        // Settings that do not depend on the length, so that pauses do not matter.
        let constant = ["optimisation.final_rate=1.0", "loss.kl_warm_up=0.0"];
        let train = |out: &Path, steps| {
            let recipe = AdapterRecipe {
                length: Span::Steps(steps),
                ..small(name, &constant)
            };
            trained(&recipe, &data, out);
        };
        let files = [FILE, STATISTICS, "adapter.checkpoint.safetensors"];
        expect_same_bytes_after_pause(&scratch.path().join(name), &files, [2, 4], train);
    }
}

#[test]
fn training_starts_from_written_weights() {
    let scratch = tempfile::tempdir().unwrap();
    let encoded = encoded(scratch.path());
    let out = scratch.path().join("first");
    trained(&small("tiny", &["length=2 steps"]), &data(&encoded), &out);
    let start = Checkpoint::open(out.join(FILE)).unwrap();
    let data = Data {
        start: Some(start.clone()),
        ..data(&encoded)
    };
    // Another seed, without effect; and two views, each half a picture.
    let recipe = small("tiny", &["seed=5", "views=2", "loss.ms_ssim=0"]);
    let task = AdapterTask::new(&recipe, 1, &data, &run_in(Path::new("."))).unwrap();
    let parameters = task.parameters().unwrap();
    assert_eq!(
        parameters.len(),
        start.names().count(),
        "all of both networks"
    );
    for parameter in parameters {
        let values = start.tensor(&parameter.name, DType::F32).unwrap();
        let values: Vec<f32> = values.flatten_all().unwrap().to_vec1().unwrap();
        assert!(values == parameter.values, "{}", parameter.name);
        let group = usize::from(parameter.name.starts_with("pixel_decoder."));
        assert_eq!(parameter.group, group, "{}", parameter.name);
    }
    let (features, pictures) = data.train.of(&[0, 3], 2).unwrap();
    assert_eq!(features.dims(), [4, GRID, GRID / 2, FEATURES]);
    assert_eq!(pictures.dims(), [4, SIDE, SIDE / 2, 3]);
}

#[test]
fn output_is_a_model_with_the_encoder() {
    let scratch = tempfile::tempdir().unwrap();
    let encoder = scratch.path().join("encoder");
    std::fs::create_dir_all(&encoder).unwrap();
    let cosmos = json!({
        "channels": 2, "multipliers": [2, 4], "res_blocks": 1, "latent": FEATURES, "patch": 2, "compression": 4,
        "groups": 2,
    });
    let transition = |channels: usize| {
        json!({
            "config": {"hidden": 16, "depth": 1, "heads": 2, "channels": channels, "patch": 1, "grid": [GRID, GRID],
                       "action_dim": 10},
            "weights": "dit.safetensors",
        })
    };
    let description = json!({
        "name": "native", "image": [SIDE, SIDE],
        "encoder": {"kind": "cosmos-ci16x16", "config": cosmos, "weights": "encoder.safetensors"},
        "transition": transition(FEATURES),
    });
    let write = |folder: &Path, description: &Value| {
        std::fs::write(folder.join("model.json"), description.to_string()).unwrap();
    };
    write(&encoder, &description);
    write_random_weights(&encoder, 1).unwrap();

    let frames = dataset(scratch.path(), false);
    let opened = DescribedFolder::open(&encoder).unwrap();
    let opened = opened.encoder(&wm_model::Compute::default()).unwrap();
    let latents = Latents::open(&frames, &*opened, &scratch.path().join("cache")).unwrap();
    let out = scratch.path().join("made");
    let encoded = (frames, latents);
    let data = Data {
        description: Some(files::encoder_of(&encoder, "made").unwrap()),
        ..data(&encoded)
    };
    trained(&small("tiny", &["length=2 steps"]), &data, &out);

    let text = std::fs::read_to_string(out.join("model.json")).unwrap();
    let mut made: Value = serde_json::from_str(&text).unwrap();
    let weights = made["encoder"]["weights"].as_str().unwrap();
    assert!(Path::new(weights).is_absolute(), "{made}");
    assert_eq!(
        (&made["name"], &made["image"]),
        (&json!("made"), &json!([SIDE, SIDE]))
    );
    made["transition"] = transition(6);
    write(&out, &made);
    write_random_weights(&out, 1).unwrap();
    let model = ModelFolder::open(&out.to_string_lossy()).unwrap();
    let (picture, _) = (data.train.of(&[0, 1, 2], 1).unwrap().1, ());
    let latent = model.encoder().unwrap().encode(&picture).unwrap();
    assert_eq!(latent.dims(), [3, GRID, GRID, 6]);
    let decoded = model.decoder().unwrap().unwrap().decode(&latent).unwrap();
    assert_eq!(decoded.dims(), [3, SIDE, SIDE, 3]);
    // With the written statistics, the latents of the training data have mean 0 and standard deviation 1.
    let all: Vec<usize> = (0..data.train.count()).collect();
    let (_, pictures) = data.train.of(&all, 1).unwrap();
    let latents = model.encoder().unwrap().encode(&pictures).unwrap();
    let square = latents.sqr().unwrap().mean_all().unwrap();
    let square = square.to_scalar::<f32>().unwrap();
    assert!((square - 1.0).abs() < 0.02, "{square}");
}

#[test]
fn unsuitable_frames_are_named() {
    let scratch = tempfile::tempdir().unwrap();
    let encoded = encoded(scratch.path());
    let data = data(&encoded);
    for (setting, expected) in [
        ("model.multipliers=[1,2]", "2 levels"),
        ("views=3", "views is 3"),
        ("micro_batch=3", "micro_batch 3"),
        ("loss.pixel=0", "loss.pixel is 0"),
        ("loss.kl=-1", "loss.kl is -1"),
    ] {
        let recipe = small("tiny", &[setting]);
        let error = AdapterTask::new(&recipe, 1, &data, &run_in(Path::new("."))).map(|_| ());
        let error = format!("{:#}", error.unwrap_err());
        assert!(error.contains(expected), "{setting}: {error}");
    }
}

#[test]
fn divergence_weight_increases() {
    let loss = small("paper", &[]).loss;
    let at = |step| loss.divergence_at(step, 1000);
    assert_eq!([at(0), at(200), at(999)], [0.0, 1e-4, 1e-4]);
    assert!((at(50) - 0.25e-4).abs() < 1e-12);
}

/// Variables and losses of a step with fixed frames and noise.
fn objective(recipe: &AdapterRecipe) -> (Objective<'_>, Variables, [Tensor; 3]) {
    let view = View {
        rows: GRID,
        columns: GRID,
        channels: FEATURES,
        height: SIDE,
        width: SIDE,
    };
    let (objective, variables) = Objective::new(recipe, view, 10, None, &on_cpu()).unwrap();
    let values = |shape: &[usize], scale: f32, shift: f32| {
        let count = shape.iter().product::<usize>();
        let values = (0..count).map(|i| shift + scale * (i as f32 * 78.233).sin());
        Tensor::from_vec(values.collect(), shape, &Device::Cpu).unwrap()
    };
    let inputs = [
        values(&[2, GRID, GRID, FEATURES], 1.0, 0.0),
        values(&[2, SIDE, SIDE, 3], 0.4, 0.5),
        values(&[2, GRID, GRID, recipe.model.latent], 1.5, 0.0),
    ];
    (objective, variables, inputs)
}

/// Along its gradient, each loss must change by the gradient's length.
#[test]
fn gradients_match_finite_differences() {
    let recipe = small(
        "tiny",
        // Large enough to be visible.
        &["loss.kl=0.3", "loss.kl_warm_up=0", "loss.ms_ssim=0.5"],
    );
    let (objective, variables, [features, pictures, noise]) = objective(&recipe);
    let losses = || {
        let losses = objective.losses(&features, &pictures, &noise, 1).unwrap();
        [losses.adapter, losses.pixel]
    };
    for (index, prefix) in ["adapter.", "pixel_decoder."].into_iter().enumerate() {
        let store = losses()[index].backward().unwrap();
        let start = variables.parameters(|_| 0).unwrap();
        let own: Vec<_> = start
            .iter()
            .filter(|parameter| parameter.name.starts_with(prefix))
            .map(|parameter| {
                let gradient = store.get(&variables.get(&parameter.name).unwrap());
                let gradient = gradient.unwrap().flatten_all().unwrap();
                (parameter, gradient.to_vec1::<f32>().unwrap())
            })
            .collect();
        let others = start.iter().filter(|p| !p.name.starts_with(prefix));
        for other in others {
            let tensor = variables.get(&other.name).unwrap();
            assert!(store.get(&tensor).is_none(), "{prefix} and {}", other.name);
        }
        let squares = own.iter().flat_map(|(_, gradient)| gradient);
        let length = squares.map(|g| g * g).sum::<f32>().sqrt();
        let at = |step: f32| {
            for (parameter, gradient) in &own {
                let moved = parameter.values.iter().zip(gradient);
                let values: Vec<f32> = moved.map(|(w, g)| w + step * g / length).collect();
                let trained = ParameterValues {
                    name: &parameter.name,
                    shape: &parameter.shape,
                    values: &values,
                };
                variables.assign(std::iter::once(trained)).unwrap();
            }
            losses()[index].to_scalar::<f32>().unwrap()
        };
        let step = 2e-3;
        let slope = (at(step) - at(-step)) / (2.0 * step);
        at(0.0);
        assert!(length > 0.01, "{prefix} {length}");
        assert!(
            (slope / length - 1.0).abs() < 0.02,
            "{prefix} gradient {length}, difference {slope}"
        );
    }
}

#[derive(Deserialize)]
struct Fixture {
    adapter: SvaeConfig,
    pixel_decoder: PixelDecoderConfig,
    loss: serde_json::Map<String, Value>,
    adapter_loss: f32,
    pixel_loss: f32,
    parts: serde_json::Map<String, Value>,
    known_ms_ssim: f32,
}

fn fixture() -> (std::path::PathBuf, Fixture) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/adapter");
    let text = std::fs::read_to_string(folder.join("config.json")).unwrap();
    (folder, serde_json::from_str(&text).unwrap())
}

/// Losses and the gradient of their sum match PyTorch to 1e-4 relative.
#[test]
fn step_matches_pytorch() {
    let (folder, fixture) = fixture();
    let open = |name: &str| Checkpoint::open(folder.join(format!("{name}.safetensors"))).unwrap();
    let input = open("input");
    let input = |name: &str| input.tensor(name, DType::F32).unwrap();
    let (features, pictures) = (input("features"), input("pictures"));
    let (_, rows, columns, channels) = features.dims4().unwrap();
    let (_, height, width, _) = pictures.dims4().unwrap();
    let (svae, pixel) = (&fixture.adapter, &fixture.pixel_decoder);
    let mut settings = vec![
        format!("model.latent={}", svae.latent),
        format!("model.heads={}", svae.heads),
        format!("model.layers={}", svae.layers),
        format!("model.ffn={}", svae.ffn),
        format!("model.base={}", pixel.base),
        format!("model.multipliers={:?}", pixel.multipliers),
        format!("model.res_blocks={}", pixel.res_blocks),
        format!("model.pixel_heads={}", pixel.heads),
        "loss.kl_warm_up=0".to_owned(),
    ];
    let weights = fixture.loss.iter();
    settings.extend(weights.map(|(name, value)| format!("loss.{name}={value}")));
    let settings: Vec<&str> = settings.iter().map(String::as_str).collect();
    let recipe = small("paper", &settings);
    let lpips = Lpips::open(
        &folder.join("alexnet.safetensors"),
        &folder.join("heads.safetensors"),
    )
    .unwrap();
    let view = View {
        rows,
        columns,
        channels,
        height,
        width,
    };
    let (objective, variables) = Objective::new(&recipe, view, 1, Some(&lpips), &on_cpu()).unwrap();
    files::start_from(&open("weights"), &variables).unwrap();
    let losses = objective
        .losses(&features, &pictures, &input("noise"), 1)
        .unwrap();
    let close = |name: &str, found: f32, expected: f32| {
        let difference = (found / expected - 1.0).abs();
        assert!(difference < 1e-4, "{name}: {found}, PyTorch {expected}");
    };
    assert_eq!(losses.parts.len(), fixture.parts.len());
    for (name, value) in &losses.parts {
        let expected = fixture.parts[*name].as_f64().unwrap();
        close(name, *value as f32, expected as f32);
    }
    let scalar = |loss: &Tensor| loss.to_scalar::<f32>().unwrap();
    close("adapter", scalar(&losses.adapter), fixture.adapter_loss);
    close("pixel", scalar(&losses.pixel), fixture.pixel_loss);

    let store = (losses.adapter + losses.pixel).unwrap().backward().unwrap();
    let found = variables
        .gradients(&store, &WeightGradients::default())
        .unwrap();
    let expected = open("gradient");
    let names = variables.parameters(|_| 0).unwrap();
    assert_eq!(names.len(), expected.names().count());
    let length = |values: &[f32]| values.iter().map(|v| v * v).sum::<f32>().sqrt();
    let largest = found.iter().map(|values| length(values));
    let largest = largest.fold(0.0, f32::max);
    for (parameter, found) in names.iter().zip(&found) {
        let name = &parameter.name;
        let expected = expected.tensor(name, DType::F32).unwrap();
        let expected: Vec<f32> = expected.flatten_all().unwrap().to_vec1().unwrap();
        let difference: Vec<f32> = found.iter().zip(&expected).map(|(a, b)| a - b).collect();
        // Some parameters have no effect (biases of keys, and those before a norm of single channels): their gradients are
        // rounding errors.
        let relative = length(&difference) / length(&expected).max(1e-3 * largest);
        assert!(relative < 1e-4, "{name}: {relative}");
    }
}

#[test]
fn ms_ssim_matches_pytorch() {
    let (_, fixture) = fixture();
    let (height, width) = (192usize, 176usize);
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for y in 0..height {
        for x in 0..width {
            for c in 0..3 {
                let first = (x * 7 + y * 3 + c * 29 + (x * y) % 31 * 5) % 256;
                a.push(first as f32 / 255.0);
                b.push(((first * 3 + (x * 11 + y * 5) % 256) / 4) as f32 / 255.0);
            }
        }
    }
    let [a, b] = [a, b].map(|v| Tensor::from_vec(v, (1, height, width, 3), &Device::Cpu).unwrap());
    let ms_ssim = MsSsim::new((height, width)).unwrap();
    assert_eq!(ms_ssim.scales(), 5);
    let found = ms_ssim.of(&a, &b).unwrap().to_scalar::<f32>().unwrap();
    assert!(
        (found - fixture.known_ms_ssim).abs() < 1e-5,
        "{found}, pytorch_msssim {}",
        fixture.known_ms_ssim
    );
}
