//! Pictures of another aspect than the model's.

use std::{
    fs,
    path::{Path, PathBuf},
    slice::from_ref,
};

use image::{GrayImage, Luma, Rgb, RgbImage};
use wm_model::{Fit, Framing};

use super::super::{Data, DataOptions, Dataset, Manifest, store::read_manifest};
use super::folder::wm_dataset;
use crate::testing::{CAMERA, Recorder, png};

const MASK: &str = "/camera/mask/compressed";

/// Each pixel encodes its position.
fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| Rgb([x as u8, y as u8, 9]))
}

/// A bag of consecutive pictures of these sizes.
fn bag(dir: &Path, sizes: &[(u32, u32)]) -> PathBuf {
    let bag = dir.join("bag");
    let mut recorder = Recorder::new(&bag);
    for (ms, (width, height)) in (0..).step_by(200).zip(sizes) {
        recorder.picture(CAMERA, ms, png(picture(*width, *height).into()));
        recorder.action(ms, 0.01);
    }
    recorder.finish();
    bag
}

/// Prepares the bag with further arguments.
fn prepared(dir: &Path, name: &str, bag: &Path, more: &[&str]) -> PathBuf {
    let out = dir.join(name);
    let line = [bag.to_str().unwrap(), "-o", out.to_str().unwrap()];
    let size = ["--size", "16x16", "--validation", "0"];
    wm_dataset(&[&line[..], &size, more].concat()).unwrap();
    out
}

fn open(path: &Path, framing: Framing, cache: &Path) -> Result<Dataset, String> {
    let data = Data::open(
        from_ref(&path.to_owned()),
        framing,
        cache,
        &DataOptions::default(),
    );
    data.map(|data| data.training).map_err(|e| e.to_string())
}

#[test]
fn frames_of_bags_and_folders_are_framed_alike() {
    let dir = tempfile::tempdir().unwrap();
    let bag = bag(dir.path(), &[(64, 36); 4]);
    let cache = dir.path().join("cache");
    for fit in Fit::ALL {
        let framing = Framing::new((16, 16), fit);
        let expected = framing.apply(&picture(64, 36)).unwrap();
        let folder = prepared(dir.path(), fit.name(), &bag, &["--fit", fit.name()]);
        for dataset in [open(&bag, framing, &cache), open(&folder, framing, &cache)] {
            let dataset = dataset.unwrap();
            assert_eq!(dataset.frame(3), Some(&**expected.as_raw()), "{fit}");
            assert_eq!(dataset.framing(), framing);
            let size = dataset.picture_size().unwrap();
            assert_eq!(size.to_string(), "64x36");
        }
    }
    // Each fit has frames of its own.
    assert_eq!(fs::read_dir(&cache).unwrap().count(), 3);
}

#[test]
fn wm_dataset_crops_and_other_fits_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let bag = bag(dir.path(), &[(64, 36); 4]);
    let folder = prepared(dir.path(), "data", &bag, &[]);
    let manifest = read_manifest(&folder).unwrap();
    assert_eq!(manifest.fit, Fit::Crop);
    let text = manifest.to_string();
    assert!(text.contains("16x16 each, fit crop"), "{text}");
    assert!(text.contains("4 pictures of 64x36"), "{text}");
    let cache = dir.path().join("cache");
    let refused = |size, fit| open(&folder, Framing::new(size, fit), &cache).unwrap_err();
    let error = refused((16, 16), Fit::Stretch);
    for part in ["fit crop", "64x36", "--fit stretch --size 16x16"] {
        assert!(error.contains(part), "{error}");
    }
    // The middle of the middle shows less than the middle.
    let error = refused((8, 12), Fit::Crop);
    assert!(error.contains("--fit crop --size 8x12"), "{error}");
    let smaller = Framing::new((8, 8), Fit::Crop);
    assert_eq!(open(&folder, smaller, &cache).unwrap().size(), (8, 8));
}

#[test]
fn equal_aspect_suits_every_fit() {
    let dir = tempfile::tempdir().unwrap();
    let bag = bag(dir.path(), &[(32, 32); 4]);
    let folder = prepared(dir.path(), "data", &bag, &[]);
    let cache = dir.path().join("cache");
    let frame = |fit| {
        let dataset = open(&folder, Framing::new((16, 16), fit), &cache).unwrap();
        dataset.frame(0).unwrap().to_vec()
    };
    assert_eq!(frame(Fit::Stretch), frame(Fit::Crop));
    assert_eq!(frame(Fit::Pad), frame(Fit::Crop));
}

#[test]
fn a_folder_without_a_fit_is_stretched() {
    let dir = tempfile::tempdir().unwrap();
    let bag = bag(dir.path(), &[(64, 36); 4]);
    let folder = prepared(dir.path(), "data", &bag, &["--fit", "stretch"]);
    let path = folder.join("dataset.json");
    let mut manifest: serde_json::Value =
        serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    let fields = manifest.as_object_mut().unwrap();
    assert!(!fields.contains_key("fit"), "as in earlier versions");
    // Earlier versions recorded no sizes.
    fields.remove("source_sizes").unwrap();
    fs::write(&path, manifest.to_string()).unwrap();
    let cache = dir.path().join("cache");
    let stretched = open(&folder, Framing::from((16, 16)), &cache).unwrap();
    assert_eq!(stretched.picture_size(), None);
    let error = open(&folder, Framing::new((16, 16), Fit::Crop), &cache).unwrap_err();
    assert!(
        error.contains("fit stretch") && error.contains("--fit crop"),
        "{error}"
    );
}

#[test]
fn several_sizes_of_one_camera_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let bag = bag(
        dir.path(),
        &[(64, 36), (64, 36), (32, 32), (32, 32), (32, 32)],
    );
    let folder = prepared(dir.path(), "data", &bag, &[]);
    let manifest: Manifest = read_manifest(&folder).unwrap();
    let mixed = manifest.mixed_sizes();
    let [text] = &*mixed else { panic!("{mixed:?}") };
    for part in [
        "/camera/image_raw",
        "32x32 (3 pictures)",
        "64x36 (2 pictures)",
    ] {
        assert!(text.contains(part), "{text}");
    }
    assert_eq!(manifest.picture_size(), None);
}

#[test]
fn masks_are_placed_like_their_pictures() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let mut recorder = Recorder::new(&bag);
    for ms in (0..800).step_by(200) {
        recorder.picture(CAMERA, ms, png(picture(64, 32).into()));
        // Class 5 in the left half.
        let mask = GrayImage::from_fn(64, 32, |x, _| Luma([if x < 32 { 5 } else { 0 }]));
        recorder.picture(MASK, ms, png(mask.into()));
        recorder.action(ms, 0.01);
    }
    recorder.finish();
    let cache = dir.path().join("cache");
    let mask = |fit| {
        let dataset = open(&bag, Framing::new((16, 16), fit), &cache).unwrap();
        dataset.mask(0).unwrap().to_vec()
    };
    let half = |x: usize| if x < 8 { 5 } else { 0 };
    let cropped: Vec<u8> = (0..256).map(|at| half(at % 16)).collect();
    assert_eq!(mask(Fit::Crop), cropped);
    let padded: Vec<u8> = (0..256)
        .map(|at| {
            if (4..12).contains(&(at / 16)) {
                half(at % 16)
            } else {
                0
            }
        })
        .collect();
    assert_eq!(mask(Fit::Pad), padded);
}

#[test]
fn incomplete_mask_is_excluded() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let mut recorder = Recorder::new(&bag);
    let mut jpeg = std::io::Cursor::new(Vec::new());
    let mask = GrayImage::from_fn(64, 32, |x, y| Luma([(x * y % 7) as u8]));
    mask.write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
    let whole = jpeg.into_inner();
    for ms in (0..2000).step_by(200) {
        recorder.picture(CAMERA, ms, png(picture(64, 32).into()));
        let length = whole.len() - if ms == 800 { 80 } else { 0 };
        recorder.picture(MASK, ms, whole[..length].to_vec());
        recorder.action(ms, 0.01);
    }
    recorder.finish();
    let manifest = read_manifest(&prepared(dir.path(), "data", &bag, &[])).unwrap();
    let left_out: Vec<String> = manifest.left_out.iter().map(ToString::to_string).collect();
    let is_named = |line: &String| line.contains("cannot be decoded");
    assert!(left_out.iter().any(is_named), "{left_out:?}");
}
