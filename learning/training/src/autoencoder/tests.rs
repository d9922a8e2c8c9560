use std::{io::Cursor, path::Path};

use image::{DynamicImage, GrayImage, ImageFormat, Luma, Rgb, RgbImage};
use wm_bag::{BagWriter, WriterOptions};
use wm_dataset::Dataset;
use wm_model::{Autoencoder, AutoencoderConfig};
use wm_msgs::{
    builtin_interfaces::Time, sensor_msgs::CompressedImage, std_msgs::Header, wm_msgs::Action,
};

use super::{
    AutoencoderRecipe, TrainAutoencoderArgs, TrainingError, arguments::train_on, evaluate, picture,
    trainer::AutoencoderTask,
};
use crate::{
    arguments::{PictureRunArgs, RunArgs, tests::run_in},
    recipe::{Optimisation, Span, tests::bundled},
    run::{RunEnd, Stop},
};

const SIZE: u32 = 16;

/// A red square that moves over a shaded background, with its mask.
fn frame(at: u32) -> (DynamicImage, DynamicImage) {
    let inside = |x: u32, y: u32| (at..at + 5).contains(&x) && (4..9).contains(&y);
    let picture = RgbImage::from_fn(SIZE, SIZE, |x, y| {
        if inside(x, y) {
            Rgb([220, 40, 30])
        } else {
            Rgb([60 + 8 * y as u8, 90, 120 - 4 * x as u8])
        }
    });
    let mask = GrayImage::from_fn(SIZE, SIZE, |x, y| Luma([2 * u8::from(inside(x, y))]));
    (picture.into(), mask.into())
}

fn write_bag(dir: &Path, masks: bool) {
    let mut writer = BagWriter::create(dir, WriterOptions::default()).unwrap();
    for index in 0..8u32 {
        let header = Header {
            stamp: Time::from_nanos(i64::from(index) * 200_000_000),
            frame_id: String::new(),
        };
        let at = u64::from(index) * 200_000_000;
        let (picture, mask) = frame(index + 1);
        let mut pictures = vec![("/camera/image_raw/compressed", picture)];
        if masks {
            pictures.push(("/camera/mask/compressed", mask));
        }
        for (topic, picture) in pictures {
            let mut png = Cursor::new(Vec::new());
            picture.write_to(&mut png, ImageFormat::Png).unwrap();
            let message = CompressedImage {
                header: header.clone(),
                format: "png".into(),
                data: png.into_inner(),
            };
            writer.write(topic, &message, at).unwrap();
        }
        let action = Action {
            header,
            values: vec![0.0; 7],
        };
        writer.write("/wm/action", &action, at).unwrap();
    }
    writer.finish().unwrap();
}

/// One episode of such frames.
pub(crate) fn dataset(scratch: &Path, masks: bool) -> Dataset {
    let bags = scratch.join(format!("bags_{masks}"));
    if !bags.exists() {
        write_bag(&bags.join("episode_000000"), masks);
    }
    Dataset::open(
        &bags,
        &scratch.join("cache"),
        (SIZE as usize, SIZE as usize),
    )
    .unwrap()
}

fn recipe() -> AutoencoderRecipe {
    let tiny: AutoencoderRecipe = bundled("tiny", &["model.name=test"]);
    AutoencoderRecipe {
        model: AutoencoderConfig {
            name: "test".into(),
            height: SIZE as usize,
            width: SIZE as usize,
            widths: vec![8, 16],
            encoder_blocks: vec![0, 1],
            decoder_blocks: vec![0, 1],
            latent_channels: 4,
            branch: false,
            ..tiny.model
        },
        seed: 3,
        length: Span::Steps(60),
        whole_picture_share: 0.1667,
        batch: 4,
        crop: 8,
        optimisation: Optimisation {
            warm_up: Span::Steps(5),
            learning_rate: 3e-3,
            ema_decay: 0.9,
            ..tiny.optimisation
        },
        ..tiny
    }
}

fn trained(recipe: &AutoencoderRecipe, dataset: &Dataset, out: &Path) -> Autoencoder {
    let ended = train_on(
        &run_in(out),
        recipe,
        dataset,
        Some(dataset),
        &Stop::default(),
    );
    assert_eq!(ended.unwrap(), RunEnd::Finished);
    Autoencoder::open(out).unwrap()
}

#[test]
fn training_learns_and_writes_weights_and_curve() {
    let scratch = tempfile::tempdir().unwrap();
    for masks in [false, true] {
        let dataset = dataset(scratch.path(), masks);
        let out = scratch.path().join(format!("run_{masks}"));
        let trained = trained(&recipe(), &dataset, &out);
        let fresh = Autoencoder::random(recipe().model, 3).unwrap();
        let before = evaluate(&fresh, &dataset, 8).unwrap();
        let after = evaluate(&trained, &dataset, 8).unwrap();
        assert!(after.psnr > before.psnr + 6.0, "{before} then {after}");
        assert_eq!(after.masked_psnr.is_some(), masks);
        // The latents of the training data are normalised.
        assert!((after.latent_std - 1.0).abs() < 0.05, "{after}");
        for file in [
            "autoencoder.loss.svg",
            "autoencoder.samples/step_0000060.png",
        ] {
            assert!(out.join(file).is_file(), "{file}");
        }
        let journal = std::fs::read_to_string(out.join("autoencoder.journal.jsonl")).unwrap();
        assert!(journal.contains("\"psnr\""), "{journal}");
        let picture = picture(&trained, &dataset, 2).unwrap();
        assert_eq!(picture.dimensions(), (3 * SIZE, 2 * SIZE));
    }
}

#[test]
fn resumed_training_gives_the_uninterrupted_weights() {
    let scratch = tempfile::tempdir().unwrap();
    let dataset = dataset(scratch.path(), true);
    let (whole, parts) = (scratch.path().join("whole"), scratch.path().join("parts"));
    let shorter = AutoencoderRecipe {
        length: Span::Steps(20),
        // A learning rate that does not depend on the length, so that pauses do not matter.
        optimisation: Optimisation {
            final_rate: 1.0,
            ..recipe().optimisation
        },
        whole_picture_share: 0.0,
        ..recipe()
    };
    let pause = AutoencoderRecipe {
        length: Span::Steps(9),
        ..shorter.clone()
    };
    let all = trained(&shorter, &dataset, &whole);
    trained(&pause, &dataset, &parts);
    let resumed = trained(&shorter, &dataset, &parts);
    assert_eq!(all.space().hash, resumed.space().hash);

    let other = AutoencoderRecipe {
        crop: 16,
        ..shorter
    };
    let error = train_on(&run_in(&parts), &other, &dataset, None, &Stop::default()).unwrap_err();
    let error = format!("{error:#}");
    assert!(
        error.contains("recipe.crop: 8 in the checkpoint, 16 now"),
        "{error}"
    );
}

/// Along each half's gradient the loss must change by the gradient's length: checks picture loss, decoder, clamp, noise,
/// penalty and encoder against finite differences.
#[test]
fn gradient_matches_finite_differences() {
    let scratch = tempfile::tempdir().unwrap();
    let dataset = dataset(scratch.path(), true);
    let recipe = AutoencoderRecipe {
        // Large enough to be visible beside the picture's loss.
        latent_penalty: 0.3,
        latent_noise: 0.3,
        ..recipe()
    };
    let mut task = AutoencoderTask::new(recipe, 60, &dataset, None).unwrap();
    for half in 0..2 {
        let (length, slope) = task.slope_along_gradient(half, 2e-3).unwrap();
        assert!(length > 0.01, "half {half}: {length}");
        assert!(
            (slope / length - 1.0).abs() < 0.03,
            "half {half}: gradient {length}, difference {slope}"
        );
    }
}

#[test]
fn frames_of_another_size_are_rejected() {
    let scratch = tempfile::tempdir().unwrap();
    let dataset = dataset(scratch.path(), true);
    let tiny: AutoencoderRecipe = bundled("tiny", &["model.name=test"]);
    let error = AutoencoderTask::new(tiny, 1, &dataset, None)
        .map(|_| ())
        .unwrap_err();
    assert!(
        matches!(
            error,
            TrainingError::FrameSize {
                expected: (128, 128),
                found: (16, 16)
            }
        ),
        "{error}"
    );
}

#[test]
fn short_training_keeps_the_share_of_whole_pictures() {
    let asked = |setting: &str| {
        let run = RunArgs {
            set: vec![setting.parse().unwrap()],
            ..run_in(Path::new("/no/such/folder"))
        };
        let on = PictureRunArgs { run, fit: None };
        TrainAutoencoderArgs { on }.recipe()
    };
    let tiny = asked("model.name=test").unwrap();
    let found = [5500, 275].map(|steps| tiny.whole_picture_steps(steps));
    assert_eq!(found, [900, 45]);
    for share in ["1.2", "-0.1"] {
        let error = asked(&format!("whole_picture_share={share}")).unwrap_err();
        let expected = format!("whole_picture_share is {share}, expected 0 to 1");
        assert_eq!(error.to_string(), expected);
    }
}
