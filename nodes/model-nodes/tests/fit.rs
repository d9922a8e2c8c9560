//! A picture of another aspect than the model's has the same latent by every way into the model.

use image::{ImageFormat, Rgb, RgbImage};
use wm_camera::{camera_frame::CameraFrame, image_message::encode_image};
use wm_dataset::{
    Data, DataOptions, Dataset, Latents,
    testing::{Recorder, write_moves},
};
use wm_model::{Autoencoder, AutoencoderConfig, Encoder as _, Fit, Framing};
use wm_model_nodes::{encoder::EncoderStep, planner::GoalReader, views::Joiner};
use wm_msgs::{sensor_msgs::CompressedImage, std_msgs::Header, wm_msgs::Goal};
use wm_wire::latent_message::{LatentDtype, decode_latent};

/// As exact as the 16-bit numbers of a cache.
const EXACT: f32 = 2e-3;

fn encoder(fit: Fit) -> Autoencoder {
    let config = AutoencoderConfig {
        height: 32,
        width: 32,
        fit,
        ..AutoencoderConfig::tiny()
    };
    Autoencoder::random(config, 1).unwrap()
}

fn step(fit: Fit) -> EncoderStep {
    EncoderStep::new(Box::new(encoder(fit)), LatentDtype::F32)
}

/// 16:9, with other colours in the middle than at the sides.
fn wide() -> RgbImage {
    RgbImage::from_fn(160, 90, |x, y| {
        let side = if (35..125).contains(&x) { 0 } else { 200 };
        Rgb([side, (x % 90) as u8 * 2, y as u8 * 2])
    })
}

fn expect_near(found: &[f32], expected: &[f32], what: &str) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        let bound = EXACT * expected.abs().max(1.0);
        assert!(
            (found - expected).abs() < bound,
            "{what}: {found} {expected}"
        );
    }
}

/// Pictures of two cameras, of different sizes and transports, joined live and prepared for a training.
#[test]
fn joined_cameras_equal_the_frames_of_training() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let narrow = RgbImage::from_fn(40, 60, |x, y| Rgb([x as u8 * 6, y as u8 * 4, 90]));
    let mut recorder = Recorder::new(&bag);
    for at in (0..800).step_by(200) {
        recorder.picture("/front/image_raw/compressed", at, png(&wide()));
        recorder.picture("/wrist/image_raw/compressed", at + 30, png(&narrow));
        recorder.action(at, 0.01);
    }
    recorder.finish();
    for fit in Fit::ALL {
        let options = DataOptions {
            cameras: vec!["/front/image_raw".into(), "/wrist/image_raw".into()],
            validation: Some(0.0),
            ..DataOptions::default()
        };
        let framing = Framing::new((32, 64), fit);
        let cache = dir.path().join(fit.name());
        let data = Data::open(std::slice::from_ref(&bag), framing, &cache, &options).unwrap();
        let training = data.training;
        assert_eq!(training.views(), 2);
        let frames = [
            CameraFrame::Raw(encode_image(&wide(), Header::default())),
            CameraFrame::Compressed(CompressedImage {
                format: "png".into(),
                data: png(&narrow),
                ..CompressedImage::default()
            }),
        ];
        let joined = Joiner::new(training.framing()).join(&frames).unwrap();
        assert_eq!(training.frame(1), Some(joined.as_raw().as_slice()), "{fit}");
    }
}

fn png(picture: &RgbImage) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png).unwrap();
    bytes.into_inner()
}

#[test]
fn nodes_goals_and_data_give_one_latent() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    write_moves(&bag, (0..4).map(|_| (wide(), 0.01)));
    let cache = dir.path().join("cache");
    let image = || encode_image(&wide(), Header::default());
    let mut of_fits = Vec::new();
    for fit in Fit::ALL {
        let latent = step(fit).encode(&CameraFrame::Raw(image())).unwrap();
        let encoded = decode_latent(&latent, encoder(fit).space()).unwrap();

        let reader = GoalReader::new(step(fit));
        let goal = reader.of_picture(&CameraFrame::Raw(image())).unwrap();
        assert_eq!(*goal.latents[0], *encoded, "{fit}: a goal by its topic");
        let message = Goal {
            images: vec![image()],
            ..Goal::default()
        };
        let goal = reader.of_message(&message).unwrap();
        assert_eq!(*goal.latents[0], *encoded, "{fit}: a goal in a message");

        let encoder = encoder(fit);
        let dataset = Dataset::open(&bag, &cache, encoder.framing()).unwrap();
        let latents = Latents::open(&dataset, &encoder, &cache).unwrap();
        let mut prepared = Vec::new();
        latents.read(2, &mut prepared).unwrap();
        expect_near(&prepared, &encoded, fit.name());
        of_fits.push(encoded);
    }
    let differs = |a: &[f32], b: &[f32]| a.iter().zip(b).any(|(a, b)| (a - b).abs() > 0.05);
    assert!(differs(&of_fits[0], &of_fits[1]) && differs(&of_fits[1], &of_fits[2]));
}
