use rand::Rng;

use super::*;
use crate::ops::conv_layers::{ConvGradients, Tape};
use crate::{Fit, PictureSize, random};

fn config() -> AutoencoderConfig {
    AutoencoderConfig {
        name: "test".into(),
        height: 8,
        width: 12,
        widths: vec![4, 6, 8],
        encoder_blocks: vec![1, 0, 1],
        decoder_blocks: vec![0, 1, 1],
        latent_channels: 3,
        branch: false,
        fit: Fit::Stretch,
        trained_on: None,
    }
}

fn images(seed: u64) -> Tensor {
    random::uniform(&[2, 8, 12, 3], seed).unwrap()
}

fn flat(tensor: &Tensor) -> Vec<f32> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

fn reopen(builder: &WeightsBuilder) -> Result<Autoencoder> {
    Autoencoder::from_weights(Weights::from_bytes("test.safetensors", builder.to_bytes())?)
}

#[test]
fn a_saved_autoencoder_is_the_same_when_opened() {
    for branch in [false, true] {
        let config = AutoencoderConfig { branch, ..config() };
        let normalisation = Normalisation {
            mean: vec![0.1, -0.2, 0.3],
            std: vec![0.5, 2.0, 1.5],
        };
        let saved = Autoencoder::random(config, 1)
            .unwrap()
            .with_normalisation(normalisation)
            .unwrap();
        let opened = reopen(&saved.to_builder(Precision::F32)).unwrap();
        assert_eq!(saved.space(), opened.space());
        let latents = saved.encode(&images(2)).unwrap();
        assert_eq!(latents.dims(), [2, 2, 3, 3]);
        assert_eq!(flat(&latents), flat(&opened.encode(&images(2)).unwrap()));
        let decoded = opened.decode(&latents).unwrap();
        assert_eq!(decoded.dims(), [2, 8, 12, 3]);
        assert_eq!(flat(&decoded), flat(&saved.decode(&latents).unwrap()));
    }
}

#[test]
fn a_file_of_half_floats_states_the_space_that_it_holds() {
    let autoencoder = Autoencoder::random(config(), 1).unwrap();
    let opened = reopen(&autoencoder.to_builder(Precision::F16)).unwrap();
    assert_ne!(opened.space().hash, autoencoder.space().hash);
    assert_eq!(
        reopen(&opened.to_builder(Precision::F32)).unwrap().space(),
        opened.space()
    );
}

#[test]
fn weights_and_normalisation_define_the_space() {
    let space = |seed, mean| {
        Autoencoder::random(config(), seed)
            .unwrap()
            .with_normalisation(Normalisation {
                mean: vec![mean; 3],
                std: vec![1.0; 3],
            })
            .unwrap()
            .space
            .hash
    };
    assert_eq!(space(1, 0.0), space(1, 0.0));
    assert_ne!(space(1, 0.0), space(2, 0.0));
    assert_ne!(space(1, 0.0), space(1, 0.5));
}

#[test]
fn what_is_wrong_with_a_file_is_named() {
    let autoencoder = Autoencoder::random(config(), 1).unwrap();
    let message = |change: &dyn Fn(&mut WeightsBuilder)| {
        let mut builder = autoencoder.to_builder(Precision::F32);
        change(&mut builder);
        reopen(&builder).unwrap_err().to_string()
    };
    assert_eq!(
        message(&|b| b.values("encoder.9.bias", &[1], &[0.0], Precision::F32)),
        "test.safetensors: unexpected tensors: encoder.9.bias"
    );
    assert_eq!(
        message(&|b| b.values("decoder.1.bias", &[5], &[0.0; 5], Precision::F32)),
        "test.safetensors: tensor `decoder.1.bias` has shape [5], expected [8]"
    );
    assert!(
        message(&|b| b.metadata(SPACE_HASH, "0123"))
            .starts_with("test.safetensors: the hash of the latent space is ")
    );
    assert!(
        message(&|b| b.values("latent_std", &[3], &[1.0, 0.0, 1.0], Precision::F32))
            .starts_with("latent_std: channel 1 is not positive")
    );
    let wider = AutoencoderConfig {
        encoder_blocks: vec![1, 1, 1],
        ..config()
    };
    assert!(
        message(&|b| b.metadata(CONFIG, serde_json::json!(wider).to_string()))
            .contains("is missing")
    );
    assert!(
        message(&|b| b.metadata(CONFIG, "{"))
            .starts_with("test.safetensors: metadata entry `config`")
    );
}

#[test]
fn a_folder_is_opened_by_what_it_holds() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let error = Autoencoder::open(path).unwrap_err().to_string();
    assert!(error.contains("autoencoder.safetensors"), "{error}");

    // The published shape with random weights: the halves without prefix, each in its file.
    let published = Autoencoder::random(AutoencoderConfig::taef2(256, 256), 1).unwrap();
    let halves = [published.encoder(), published.decoder()];
    for (network, name) in halves.into_iter().zip(Autoencoder::TAEF2_FILES) {
        let mut builder = WeightsBuilder::new();
        network.store(&mut builder, "", Precision::F32);
        builder.write(path.join(name)).unwrap();
    }
    let opened = Autoencoder::open(path).unwrap();
    assert_eq!(opened.space(), published.space());
    assert_eq!(opened.space().shape(), (32, 32, 32));
    assert_eq!(opened.encoder().parameters(), 1_338_528);

    let own = Autoencoder::random(config(), 1).unwrap();
    own.save(path.join(Autoencoder::FILE), Precision::F32)
        .unwrap();
    assert_eq!(Autoencoder::open(path).unwrap().space(), own.space());
}

#[test]
fn inputs_of_the_wrong_shape_or_with_nan_are_refused() {
    let autoencoder = Autoencoder::random(config(), 1).unwrap();
    let image = Tensor::zeros((1, 8, 8, 3), DType::F32, &Device::Cpu).unwrap();
    assert_eq!(
        autoencoder.encode(&image).unwrap_err().to_string(),
        "images has shape [1, 8, 8, 3], expected (N, 8, 12, 3)"
    );
    let latent = Tensor::full(f32::NAN, (1, 2, 3, 3), &Device::Cpu).unwrap();
    assert_eq!(
        autoencoder.decode(&latent).unwrap_err().to_string(),
        "latents has a value that is not finite"
    );
}

#[test]
fn a_channel_that_does_not_vary_cannot_be_normalised() {
    let error = Normalisation::of([vec![1.0, 2.0, 1.0, 3.0]], 2).unwrap_err();
    assert!(
        error.to_string().starts_with("latent_std: channel 0"),
        "{error}"
    );
    let ok = Normalisation::of([vec![1.0, 2.0], vec![3.0, 6.0]], 2).unwrap();
    assert_eq!((ok.mean, ok.std), (vec![2.0, 4.0], vec![1.0, 2.0]));
}

/// A loss that is not linear, so that the ReLUs' own gradients matter: half the sum of squares.
fn loss(network: &Network, input: &[f32], grid: GridSize) -> f64 {
    let output = network.run(input.to_vec(), grid).unwrap();
    output
        .iter()
        .map(|v| 0.5 * f64::from(*v) * f64::from(*v))
        .sum()
}

#[test]
fn tape_has_the_gradients_of_finite_differences() {
    let autoencoder = Autoencoder::random(config(), 3).unwrap();
    let halves = [
        (autoencoder.encoder().clone(), 8, 12, 3),
        (autoencoder.decoder().clone(), 2, 3, 3),
    ];
    for (mut network, height, width, channels) in halves {
        let grid = GridSize {
            images: 2,
            height,
            width,
        };
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut input: Vec<f32> = (0..grid.pixels() * channels)
            .map(|_| rng.random_range(-1.0..1.0))
            .collect();
        let mut tape = Tape::default();
        let output = network.record(&mut tape, &input, grid).unwrap().to_vec();
        assert_eq!(output, network.run(input.clone(), grid).unwrap());
        let mut gradients = ConvGradients::default();
        let mut by_input = Vec::new();
        let wants = Some(&mut by_input);
        tape.backward(network.convs(), &output, &mut gradients, wants)
            .unwrap();
        // Not completed by what is left in the buffers from before.
        let short = &output[1..];
        let error = tape.backward(network.convs(), short, &mut gradients, None);
        assert!(error.unwrap_err().to_string().contains("gradient"));

        // Where a ReLU has its kink within the step, the two one-sided differences differ and the
        // gradient is one of them, or lies between.
        let mut checked = 0;
        let step = 1e-3f32;
        let middle = loss(&network, &input, grid);
        let mut compare = |found: f32, up: f64, down: f64| {
            let sides = [up - middle, middle - down].map(|d| (d / f64::from(step)) as f32);
            let tolerance = 0.02 * (0.1 + found.abs());
            let low = sides[0].min(sides[1]) - tolerance;
            let high = sides[0].max(sides[1]) + tolerance;
            assert!(
                (low..=high).contains(&found),
                "{found} not in {low}..{high}"
            );
            checked += 1;
        };
        for i in (0..input.len()).step_by(7) {
            let value = input[i];
            input[i] = value + step;
            let up = loss(&network, &input, grid);
            input[i] = value - step;
            let down = loss(&network, &input, grid);
            input[i] = value;
            compare(by_input[i], up, down);
        }
        let convs: Vec<_> = network.convs().cloned().collect();
        for (c, conv) in convs.iter().enumerate() {
            for i in (0..conv.weight.len()).step_by(61) {
                let mut at = |offset: f32| {
                    network.convs_mut().nth(c).unwrap().weight[i] += offset;
                    let loss = loss(&network, &input, grid);
                    network.convs_mut().nth(c).unwrap().weight[i] = conv.weight[i];
                    loss
                };
                let (up, down) = (at(step), at(-step));
                compare(gradients.convs[c].0[i], up, down);
            }
            for i in 0..conv.bias.as_ref().map_or(0, Vec::len) {
                let mut at = |offset: f32| {
                    let changed = network.convs_mut().nth(c).unwrap();
                    changed.bias.as_mut().unwrap()[i] += offset;
                    let loss = loss(&network, &input, grid);
                    network.convs_mut().nth(c).unwrap().bias = conv.bias.clone();
                    loss
                };
                let (up, down) = (at(step), at(-step));
                compare(gradients.convs[c].1[i], up, down);
            }
        }
        assert!(checked > 100, "{checked}");
    }
}

#[test]
fn a_network_with_a_branch_is_not_trained() {
    let config = AutoencoderConfig {
        branch: true,
        ..config()
    };
    let autoencoder = Autoencoder::random(config, 1).unwrap();
    let grid = GridSize {
        images: 1,
        height: 8,
        width: 12,
    };
    let error = autoencoder
        .encoder()
        .record(&mut Tape::default(), &[0.0; 8 * 12 * 3], grid)
        .unwrap_err();
    assert!(error.to_string().starts_with("branch: true"), "{error}");
}

#[test]
fn the_fit_belongs_to_the_latent_space_unless_it_is_stretch() {
    let of = |fit| Autoencoder::random(AutoencoderConfig { fit, ..config() }, 1).unwrap();
    let hash = |fit| of(fit).space().hash.clone();
    assert_ne!(hash(Fit::Stretch), hash(Fit::Crop));
    assert_ne!(hash(Fit::Pad), hash(Fit::Crop));
    // Files of earlier versions have neither key, and keep their hash.
    let config = serde_json::json!(of(Fit::Stretch).config());
    assert!(config.get("fit").is_none() && config.get("trained_on").is_none());
}

#[test]
fn a_saved_autoencoder_frames_pictures_as_before() {
    let trained_on = Some(PictureSize {
        width: 1280,
        height: 720,
    });
    let config = AutoencoderConfig {
        fit: Fit::Crop,
        trained_on,
        ..config()
    };
    let saved = Autoencoder::random(config, 1).unwrap();
    let opened = reopen(&saved.to_builder(Precision::F16)).unwrap();
    assert_eq!(opened.config().trained_on, trained_on);
    let expected = Framing::new((8, 12), Fit::Crop);
    assert_eq!(Encoder::framing(&opened), expected);
    let tensors = opened.on_tensors(&Device::Cpu).unwrap();
    assert_eq!(Encoder::framing(&tensors), expected);
}

/// With a branch and without, several pictures at once.
#[test]
fn tensors_compute_what_kernels_compute() {
    for branch in [false, true] {
        let config = AutoencoderConfig {
            branch,
            height: 32,
            width: 64,
            ..AutoencoderConfig::tiny()
        };
        let kernels = Autoencoder::random(config, 3).unwrap();
        let tensors = kernels.clone().on_tensors(&Device::Cpu).unwrap();
        assert_eq!(tensors.space(), kernels.space());
        let images = random::uniform(&[2, 32, 64, 3], 1).unwrap();
        let latents = kernels.encode(&images).unwrap();
        check(&tensors.encode(&images).unwrap(), &latents);
        check(
            &tensors.decode(&latents).unwrap(),
            &kernels.decode(&latents).unwrap(),
        );
        let wrong = images.narrow(1, 0, 16).unwrap();
        let message = tensors.encode(&wrong).unwrap_err().to_string();
        assert!(message.contains("(N, 32, 64, 3)"), "{message}");
    }
}

fn check(found: &Tensor, expected: &Tensor) {
    assert_eq!(found.dims(), expected.dims());
    let most = |x: &Tensor| -> f32 {
        let most = x.abs().unwrap().max_all().unwrap();
        most.to_scalar().unwrap()
    };
    let difference = most(&(found - expected).unwrap());
    assert!(difference < 1e-5 * most(expected).max(1.0), "{difference}");
}
