//! What all convolutional encoders and decoders must hold: sizes of the paper, shapes, refusals.

use candle_core::{DType, Device, Tensor};
use safetensors::tensor::{Dtype, TensorView};
use wm_model::{Compute, Kernels};

use super::*;
use crate::{Checkpoint, Error, Loader, Result};

fn skeleton() -> Loader<'static> {
    Loader::skeleton(Kernels::Candle)
}

/// Values that the loader was asked for while `load` ran.
fn parameters<T>(load: impl FnOnce(&Loader<'static>) -> Result<T>) -> usize {
    let loader = skeleton();
    load(&loader).unwrap();
    loader.parameters()
}

fn zeros(shape: (usize, usize, usize, usize)) -> Tensor {
    Tensor::zeros(shape, DType::F32, &Device::Cpu).unwrap()
}

/// All values of `x`, which must be alike to 1e-6.
fn constant(x: &Tensor) -> f32 {
    let values: Vec<f32> = x.flatten_all().unwrap().to_vec1().unwrap();
    assert!(values.iter().all(|v| (v - values[0]).abs() < 1e-6));
    values[0]
}

fn message<T>(result: Result<T>) -> String {
    match result {
        Ok(_) => panic!("expected an error"),
        Err(error) => error.to_string(),
    }
}

/// A 1x1 convolution with bias.
fn pointwise(channels: usize) -> usize {
    channels * channels + channels
}

fn small_sd() -> SdVaeConfig {
    SdVaeConfig {
        down_block_types: vec!["DownEncoderBlock2D".to_owned(); 3],
        up_block_types: vec!["UpDecoderBlock2D".to_owned(); 3],
        block_out_channels: vec![8, 16, 16],
        latent_channels: 4,
        norm_num_groups: 4,
        ..SdVaeConfig::sd3()
    }
}

fn small_va() -> VaVaeConfig {
    VaVaeConfig {
        channels: 8,
        multipliers: vec![1, 2, 2],
        res_blocks: 1,
        latent: 6,
        resolution: 32,
        attention_resolutions: vec![8],
        groups: 4,
    }
}

fn small_cosmos() -> CosmosConfig {
    CosmosConfig {
        channels: 8,
        multipliers: vec![1, 2, 2],
        res_blocks: 1,
        latent: 5,
        patch: 4,
        compression: 16,
        groups: 4,
    }
}

fn small_pixel() -> PixelDecoderConfig {
    PixelDecoderConfig {
        latent: 6,
        base: 32,
        multipliers: vec![1, 2, 2],
        res_blocks: 2,
        heads: 4,
    }
}

#[test]
fn full_sizes_have_the_parameters_of_the_paper() {
    let sd3 = SdVaeConfig::sd3();
    assert_eq!(parameters(|l| SdVaeEncoder::load(&sd3, l)), 34_274_208);
    assert_eq!(parameters(|l| SdVaeDecoder::load(&sd3, l)), 49_545_475);
    // The table counts the next two without their 1x1 convolutions at the latent.
    let va = VaVaeConfig::f16d32();
    let encoder = parameters(|l| VaVaeEncoder::load(&va, l));
    assert_eq!(encoder - pointwise(64), 28_413_248);
    let decoder = parameters(|l| VaVaeDecoder::load(&va, l));
    assert_eq!(decoder - pointwise(32), 41_417_603);
    let cosmos = CosmosConfig::ci16x16();
    let encoder = parameters(|l| CosmosEncoder::load(&cosmos, l));
    assert_eq!(encoder - pointwise(16), 33_513_360);
    let decoder = parameters(|l| CosmosDecoder::load(&cosmos, l));
    assert_eq!(decoder - pointwise(16), 47_995_184);
    let pixel = PixelDecoderConfig::paper();
    assert_eq!(parameters(|l| PixelDecoder::load(&pixel, l)), 177_040_803);
}

#[test]
fn small_networks_give_the_right_shapes() {
    let image = zeros((2, 16, 32, 3));
    let latent = |channels| zeros((2, 2, 3, channels));
    let encoder = SdVaeEncoder::load(&small_sd(), &skeleton()).unwrap();
    assert_eq!(encoder.encode(&image).unwrap().dims(), [2, 4, 8, 4]);
    let decoder = SdVaeDecoder::load(&small_sd(), &skeleton()).unwrap();
    assert_eq!(decoder.decode(&latent(4)).unwrap().dims(), [2, 8, 12, 3]);
    let encoder = VaVaeEncoder::load(&small_va(), &skeleton()).unwrap();
    assert_eq!(encoder.encode(&image).unwrap().dims(), [2, 4, 8, 6]);
    let decoder = VaVaeDecoder::load(&small_va(), &skeleton()).unwrap();
    assert_eq!(decoder.decode(&latent(6)).unwrap().dims(), [2, 8, 12, 3]);
    let encoder = CosmosEncoder::load(&small_cosmos(), &skeleton()).unwrap();
    assert_eq!(encoder.encode(&image).unwrap().dims(), [2, 1, 2, 5]);
    let decoder = CosmosDecoder::load(&small_cosmos(), &skeleton()).unwrap();
    assert_eq!(decoder.decode(&latent(5)).unwrap().dims(), [2, 32, 48, 3]);
    let decoder = PixelDecoder::load(&small_pixel(), &skeleton()).unwrap();
    assert_eq!(decoder.decode(&latent(6)).unwrap().dims(), [2, 8, 12, 3]);
}

#[test]
fn zero_weights_give_grey_images() {
    // 0 is the middle of -1..1 and of the sigmoid.
    let decoder = SdVaeDecoder::load(&small_sd(), &skeleton()).unwrap();
    assert_eq!(
        constant(&decoder.decode(&zeros((1, 2, 2, 4))).unwrap()),
        0.5
    );
    let decoder = PixelDecoder::load(&small_pixel(), &skeleton()).unwrap();
    assert_eq!(
        constant(&decoder.decode(&zeros((1, 2, 2, 6))).unwrap()),
        0.5
    );
}

#[test]
fn a_wrong_latent_is_refused_by_name() {
    let wrong = zeros((1, 2, 2, 7));
    for (message, name) in [
        (
            message(
                SdVaeDecoder::load(&small_sd(), &skeleton())
                    .unwrap()
                    .decode(&wrong),
            ),
            "latent for the SD3 VAE has shape [1, 2, 2, 7], expected (N, h, w, 4)",
        ),
        (
            message(
                VaVaeDecoder::load(&small_va(), &skeleton())
                    .unwrap()
                    .decode(&wrong),
            ),
            "latent for the VA-VAE has shape [1, 2, 2, 7], expected (N, h, w, 6)",
        ),
        (
            message(
                CosmosDecoder::load(&small_cosmos(), &skeleton())
                    .unwrap()
                    .decode(&wrong),
            ),
            "latent for Cosmos has shape [1, 2, 2, 7], expected (N, h, w, 5)",
        ),
        (
            message(
                PixelDecoder::load(&small_pixel(), &skeleton())
                    .unwrap()
                    .decode(&wrong),
            ),
            "latent for the pixel decoder has shape [1, 2, 2, 7], expected (N, h, w, 6)",
        ),
    ] {
        assert!(message.contains(name), "{message}");
    }
}

#[test]
fn an_image_that_the_levels_do_not_divide_is_refused() {
    let encoder = CosmosEncoder::load(&small_cosmos(), &skeleton()).unwrap();
    let message = message(encoder.encode(&zeros((1, 32, 24, 3))));
    assert!(message.contains("image for Cosmos"), "{message}");
    assert!(message.contains("multiples of 16"), "{message}");
}

#[test]
fn the_sd3_latent_is_scaled_as_its_config_says() {
    // Zero weights: the mean is 0.
    let latent = |config: &SdVaeConfig| {
        let encoder = SdVaeEncoder::load(config, &skeleton()).unwrap();
        constant(&encoder.encode(&zeros((1, 8, 8, 3))).unwrap())
    };
    let library = small_sd();
    assert!((latent(&library) + 0.0609 * 1.5305).abs() < 1e-6);
    let reference = SdVaeConfig {
        shift_factor: Some(0.0),
        ..small_sd()
    };
    assert_eq!(latent(&reference), 0.0);
    let plain = SdVaeConfig {
        apply_scaling: Some(false),
        ..small_sd()
    };
    assert_eq!(latent(&plain), 0.0);
    assert_eq!(plain.scale_and_shift().unwrap(), None);
    let unsaid = SdVaeConfig {
        shift_factor: None,
        ..small_sd()
    };
    assert_eq!(unsaid.scale_and_shift().unwrap(), None);
}

#[test]
fn the_hugging_face_config_is_read_as_it_is() {
    let config: SdVaeConfig = serde_json::from_str(
        r#"{
            "_class_name": "AutoencoderKL", "_diffusers_version": "0.29.0.dev0", "act_fn": "silu",
            "block_out_channels": [128, 256, 512, 512],
            "down_block_types": ["DownEncoderBlock2D", "DownEncoderBlock2D",
                                 "DownEncoderBlock2D", "DownEncoderBlock2D"],
            "force_upcast": true, "in_channels": 3, "latent_channels": 16, "latents_mean": null,
            "latents_std": null, "layers_per_block": 2, "norm_num_groups": 32, "out_channels": 3,
            "sample_size": 1024, "scaling_factor": 1.5305, "shift_factor": 0.0609,
            "up_block_types": ["UpDecoderBlock2D", "UpDecoderBlock2D",
                               "UpDecoderBlock2D", "UpDecoderBlock2D"],
            "use_post_quant_conv": false, "use_quant_conv": false
        }"#,
    )
    .unwrap();
    assert_eq!(config, SdVaeConfig::sd3());
}

#[test]
fn faults_of_a_config_are_named() {
    let unknown = SdVaeConfig {
        down_block_types: vec!["AttnDownEncoderBlock2D".to_owned(); 3],
        ..small_sd()
    };
    let groups = VaVaeConfig {
        channels: 6,
        ..small_va()
    };
    let patch = CosmosConfig {
        patch: 3,
        ..small_cosmos()
    };
    let heads = PixelDecoderConfig {
        heads: 3,
        ..small_pixel()
    };
    for (message, field) in [
        (
            message(SdVaeEncoder::load(&unknown, &skeleton())),
            "down_block_types",
        ),
        (
            message(VaVaeDecoder::load(&groups, &skeleton())),
            "multipliers: 6 channels",
        ),
        (
            message(CosmosEncoder::load(&patch, &skeleton())),
            "patch: 3",
        ),
        (
            message(PixelDecoder::load(&heads, &skeleton())),
            "heads: 64 channels",
        ),
    ] {
        assert!(message.contains(field), "{message}");
    }
}

#[test]
fn our_own_configs_refuse_unknown_keys() {
    let mut json = serde_json::to_value(PixelDecoderConfig::paper()).unwrap();
    json["attention"] = serde_json::json!(true);
    let message = serde_json::from_value::<PixelDecoderConfig>(json)
        .unwrap_err()
        .to_string();
    assert!(message.contains("attention"), "{message}");
}

/// What `load` misses in a checkpoint that holds `present` only, as `name [shape]`, and what it did not expect there.
fn differences<T>(
    present: &[&str],
    load: impl FnOnce(&Loader<'_>) -> Result<T>,
) -> (Vec<String>, Vec<String>) {
    let views = present.iter().map(|name| {
        let view = TensorView::new(Dtype::F32, vec![1], &[0; 4]).unwrap();
        (*name, view)
    });
    let bytes = safetensors::serialize(views, None).unwrap();
    let checkpoint = Checkpoint::from_bytes("test", bytes).unwrap();
    let loader = Loader::new(&checkpoint, &Compute::on_cpu(Kernels::Candle)).unwrap();
    load(&loader).unwrap();
    match loader.finish().unwrap_err() {
        Error::Tensors {
            missing,
            unexpected,
            ..
        } => (missing, unexpected),
        other => panic!("{other}"),
    }
}

fn assert_names(missing: &[String], names: &[&str]) {
    for name in names {
        assert!(missing.iter().any(|m| m == name), "{name}: {missing:#?}");
    }
}

#[test]
fn names_are_those_of_the_published_checkpoints() {
    let (missing, unexpected) = differences(&["decoder.conv_in.bias", "extra"], |loader| {
        SdVaeEncoder::load(&small_sd(), loader)
    });
    assert_eq!(unexpected, ["extra"]);
    assert_names(
        &missing,
        &[
            "encoder.conv_in.weight [8, 3, 3, 3]",
            "encoder.down_blocks.0.resnets.1.conv2.bias [8]",
            "encoder.down_blocks.0.downsamplers.0.conv.weight [8, 8, 3, 3]",
            "encoder.down_blocks.1.resnets.0.conv_shortcut.weight [16, 8, 1, 1]",
            "encoder.mid_block.attentions.0.group_norm.weight [16]",
            "encoder.mid_block.attentions.0.to_out.0.weight [16, 16]",
            "encoder.mid_block.resnets.1.norm1.weight [16]",
            "encoder.conv_norm_out.bias [16]",
            "encoder.conv_out.weight [8, 16, 3, 3]",
        ],
    );
    let (missing, _) = differences(&["extra"], |loader| SdVaeDecoder::load(&small_sd(), loader));
    // diffusers counts up_blocks from the coarsest level.
    assert_names(
        &missing,
        &[
            "decoder.conv_in.weight [16, 4, 3, 3]",
            "decoder.up_blocks.2.resnets.0.conv_shortcut.weight [8, 16, 1, 1]",
            "decoder.up_blocks.1.upsamplers.0.conv.weight [16, 16, 3, 3]",
            "decoder.conv_out.weight [3, 8, 3, 3]",
        ],
    );
    assert!(
        !missing
            .iter()
            .any(|name| name.contains("up_blocks.2.upsamplers"))
    );

    let training = ["loss.logvar", "foundation_model.x", "decoder.x", "extra"];
    let (missing, unexpected) =
        differences(&training, |loader| VaVaeEncoder::load(&small_va(), loader));
    assert_eq!(unexpected, ["extra"]);
    assert_names(
        &missing,
        &[
            "encoder.down.1.block.0.nin_shortcut.weight [16, 8, 1, 1]",
            "encoder.down.1.downsample.conv.bias [16]",
            "encoder.down.2.attn.0.proj_out.weight [16, 16, 1, 1]",
            "encoder.mid.attn_1.q.weight [16, 16, 1, 1]",
            "encoder.norm_out.weight [16]",
            "encoder.conv_out.weight [12, 16, 3, 3]",
            "quant_conv.weight [12, 12, 1, 1]",
        ],
    );
    let (missing, _) = differences(&["extra"], |loader| VaVaeDecoder::load(&small_va(), loader));
    // Levels are counted from the finest.
    assert_names(
        &missing,
        &[
            "decoder.up.2.attn.1.norm.weight [16]",
            "decoder.up.2.upsample.conv.weight [16, 16, 3, 3]",
            "decoder.up.0.block.0.nin_shortcut.weight [8, 16, 1, 1]",
            "post_quant_conv.bias [6]",
        ],
    );
    assert!(!missing.iter().any(|name| name.contains("up.0.upsample")));

    let (missing, _) = differences(&["extra"], |loader| {
        PixelDecoder::load(&small_pixel(), loader)
    });
    assert_names(
        &missing,
        &[
            "proj_in.weight [64, 6, 1, 1]",
            "mid_block2.conv1.weight [64, 64, 3, 3]",
            "mid_attn.proj_out.weight [64, 64, 1, 1]",
            "up_levels.0.attn.norm.bias [64]",
            "up_levels.1.upsample.conv.bias [64]",
            "up_levels.2.blocks.0.skip.weight [32, 64, 1, 1]",
            "norm_out.weight [32]",
            "conv_out.weight [3, 32, 3, 3]",
        ],
    );
    assert!(!missing.iter().any(|name| name.contains("up_levels.1.attn")));
}
