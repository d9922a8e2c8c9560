//! Training on pictures of another aspect, and the fit that it records.

use std::path::{Path, PathBuf};

use clap::{Args, Parser};
use image::{Rgb, RgbImage};
use wm_dataset::testing::write_moves;
use wm_model::{Fit, Framing, PictureSize};
use wm_training::{
    autoencoder::TrainAutoencoderArgs, encoder::TrainEncoderArgs, run::Stop,
    transition::TrainTransitionArgs,
};
use wm_zoo::ModelFolder;

#[derive(Parser)]
struct Cli<A: Args> {
    #[command(flatten)]
    arguments: A,
}

/// Arguments of a training, with settings for a small model.
fn parsed<A: Args>(
    [data, out]: [&str; 2],
    more: &[&str],
    settings: &[&str],
) -> Result<A, clap::Error> {
    let line = ["train", "--data", data, "--out", out];
    let mut line = Vec::from(line);
    line.extend(["--threads", "2", "--validation", "0"]);
    line.extend(more);
    line.extend(settings.iter().flat_map(|setting| ["--set", setting]));
    Cli::try_parse_from(line).map(|cli: Cli<A>| cli.arguments)
}

/// A bag of `width` x `height` pictures of a square that moves over a shaded background.
fn bag(dir: &Path, width: u32, height: u32) -> String {
    let frames = (0..24).map(|at| {
        let picture = RgbImage::from_fn(width, height, |x, y| {
            let is_inside = (at + 4..at + 12).contains(&x) && (4..12).contains(&y);
            match is_inside {
                true => Rgb([220, 40, 30]),
                false => Rgb([60 + 4 * y as u8, 90, 120 - 2 * x as u8]),
            }
        });
        (picture, 0.01)
    });
    let bag = dir.join(format!("bag_{width}x{height}"));
    write_moves(&bag, frames);
    bag.display().to_string()
}

fn train_autoencoder(bag: &str, out: &str, more: &[&str]) -> anyhow::Result<()> {
    let settings = [
        "model.height=16",
        "model.width=16",
        "model.widths=[8, 16]",
        "model.encoder_blocks=[0, 1]",
        "model.decoder_blocks=[0, 1]",
        "model.latent_channels=4",
        "crop=8",
        "batch=2",
    ];
    let more = [&["--steps", "3"], more].concat();
    let arguments: TrainAutoencoderArgs = parsed([bag, out], &more, &settings)?;
    arguments.run(&Stop::default()).map(drop)
}

fn opened(out: &Path) -> ModelFolder {
    ModelFolder::open(out.to_str().unwrap()).unwrap()
}

fn size(width: u32, height: u32) -> Option<PictureSize> {
    Some(PictureSize { width, height })
}

#[test]
fn autoencoder_crops_by_default() {
    let dir = tempfile::tempdir().unwrap();
    let bag = bag(dir.path(), 40, 20);
    let cases: [(&[&str], Fit); 3] = [
        (&[], Fit::Crop),
        (&["--fit", "pad"], Fit::Pad),
        (&["--set", "fit=stretch"], Fit::Stretch),
    ];
    let mut spaces = Vec::new();
    for (more, fit) in cases {
        let out: PathBuf = dir.path().join(fit.name());
        train_autoencoder(&bag, out.to_str().unwrap(), more).unwrap();
        let model = opened(&out);
        assert_eq!(model.fit().unwrap(), fit);
        assert_eq!(model.trained_on().unwrap(), size(40, 20));
        let encoder = model.encoder().unwrap();
        assert_eq!(encoder.framing(), Framing::new((16, 16), fit));
        spaces.push(encoder.space().hash.clone());
        let recipe = std::fs::read_to_string(out.join("autoencoder.recipe.yaml")).unwrap();
        assert!(recipe.contains(&format!("fit: {fit}")), "{recipe}");
    }
    spaces.dedup();
    assert_eq!(spaces.len(), 3);
    let error = train_autoencoder(&bag, "/no/such/folder", &["--fit", "squeeze"]);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("squeeze"), "{error}");
}

#[test]
fn transition_model_uses_the_fit_of_its_encoder() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("model");
    let text = out.to_str().unwrap();
    train_autoencoder(&bag(dir.path(), 40, 20), text, &["--fit", "pad"]).unwrap();
    // On another camera.
    let bag = bag(dir.path(), 48, 27);
    let more = ["--encoder", text, "--steps", "1"];
    let settings = [
        "model.hidden=32",
        "model.depth=1",
        "model.heads=2",
        "batch=2",
    ];
    let arguments: TrainTransitionArgs = parsed([&bag, text], &more, &settings).unwrap();
    arguments.run(&Stop::default()).unwrap();
    let model = opened(&out);
    model.world_model().unwrap();
    assert_eq!(model.fit().unwrap(), Fit::Pad);
    assert_eq!(model.trained_on().unwrap(), size(48, 27));
}

#[test]
fn encoder_describes_its_fit() {
    let dir = tempfile::tempdir().unwrap();
    let bag = bag(dir.path(), 40, 20);
    let out = dir.path().join("encoder");
    let text = out.to_str().unwrap();
    let settings = [
        "batch=2",
        "micro_batch=2",
        "windows=2",
        "model.image=16",
        "model.patch=4",
        "model.hidden=32",
        "model.depth=1",
        "head.hidden=32",
        "head.width=8",
    ];
    let arguments: TrainEncoderArgs = parsed([&bag, text], &["--steps", "1"], &settings).unwrap();
    arguments.run(&Stop::default()).unwrap();
    let model = opened(&out);
    assert_eq!(model.fit().unwrap(), Fit::Crop);
    assert_eq!(model.trained_on().unwrap(), size(40, 20));
    let description = std::fs::read_to_string(out.join("model.json")).unwrap();
    assert!(description.contains(r#""fit": "crop""#), "{description}");
}
