#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use std::{collections::BTreeMap, fs, path::PathBuf};

use super::*;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("fixtures/jpeg")
}
/// The pictures of the fixtures, by name.
fn pictures() -> BTreeMap<String, Vec<u8>> {
    let files = fs::read_dir(folder())
        .unwrap()
        .map(|file| file.unwrap().path());
    let files = files.filter(|file| file.extension().unwrap() == "jpg");
    files
        .map(|file| {
            let name = file.file_stem().unwrap().to_str().unwrap().to_owned();
            (name, fs::read(file).unwrap())
        })
        .collect()
}

fn expected(name: &str) -> RgbImage {
    let of = name.split_once('=').map_or(name, |(_, other)| other);
    image::open(folder().join(format!("{of}.png")))
        .unwrap()
        .into_rgb8()
}

fn largest_difference(got: &RgbImage, expected: &RgbImage) -> u8 {
    let pairs = got.as_raw().iter().zip(expected.as_raw());
    pairs.map(|(a, b)| a.abs_diff(*b)).max().unwrap()
}

/// Tolerance against libjpeg-turbo, whose transform rounds differently \[levels\].
const TOLERANCE: u8 = 4;

#[test]
fn all_layouts_decode_as_with_libjpeg_turbo() {
    let pictures = pictures();
    assert!(pictures.len() > 90, "{}", pictures.len());
    for (name, data) in pictures {
        // libjpeg-turbo upsamples the colours of narrow pictures differently.
        let is_refused = name.starts_with("refused-") || name.starts_with("420-1x");
        match decode(&data) {
            Err(JpegError::Layout(_)) if is_refused => {}
            Ok(picture) if !is_refused => {
                let expected = expected(&name);
                assert_eq!(picture.dimensions(), expected.dimensions(), "{name}");
                let most = largest_difference(&picture, &expected);
                assert!(most <= TOLERANCE, "{name}: {most}");
            }
            other => panic!("{name}: {other:?}"),
        }
    }
}

#[test]
fn truncated_picture_is_incomplete() {
    for (name, data) in pictures() {
        if name.starts_with("refused-") {
            continue;
        }
        for length in (2..data.len())
            .step_by(3)
            .chain(data.len() - 20..data.len())
        {
            let cut = &data[..length];
            assert!(
                matches!(check(cut), Err(JpegError::Incomplete)),
                "{name} at {length}"
            );
            // Some drivers add an end marker to incomplete data.
            let ended = [cut, &[0xff, 0xd9]].concat();
            let is_whole = length >= data.len() - 2;
            assert_eq!(check(&ended).is_ok(), is_whole, "{name} at {length}, ended");
        }
    }
}

/// First byte of the first scan's data.
fn data_begin(data: &[u8]) -> usize {
    let mut at = 2;
    loop {
        let length = usize::from(u16::from_be_bytes([data[at + 2], data[at + 3]]));
        let is_scan = data[at + 1] == 0xda;
        at += 2 + length;
        if is_scan {
            return at;
        }
    }
}

/// A picture with a camera's size and detail.
fn camera_picture() -> Vec<u8> {
    let rgb = RgbImage::from_fn(320, 240, |x, y| {
        let wave = |a: u32, b: u32| (f64::from(a * x + b * y) / 60.0).sin();
        // Sensor noise.
        let grain = f64::from((x * 7919 + y * 104_729) % 13) - 6.0;
        let level = |wave: f64| (128.0 + 100.0 * wave + grain) as u8;
        image::Rgb([level(wave(1, 3)), level(wave(2, 1)), level(wave(3, 2))])
    });
    let message = crate::image_message::encode_jpeg(&rgb, Default::default(), 85);
    message.unwrap().data
}

#[test]
fn picture_with_missing_inner_bytes_is_rejected() {
    let data = camera_picture();
    check(&data).unwrap();
    let begin = data_begin(&data);
    // JPEG has no checksum: a decoder may resynchronise within a block and not notice a few missing bytes.
    for missing in [64, 200, 1460, 5000] {
        for at in (begin..data.len() - missing - 2).step_by(53) {
            let damaged = [&data[..at], &data[at + missing..]].concat();
            assert!(check(&damaged).is_err(), "{missing} bytes from {at}");
            assert!(decode(&damaged).is_err(), "{missing} bytes from {at}");
        }
    }
}

#[test]
fn bytes_after_the_picture_are_ignored() {
    let data = &pictures()["420"];
    let padded = [data.as_slice(), &[0; 999]].concat();
    assert_eq!(decode(&padded).unwrap(), decode(data).unwrap());
    // Webcam drivers leave a few bytes before the end marker.
    let end = data.len() - 2;
    let stray = [&data[..end], &[0x55, 0x55], &data[end..]].concat();
    assert_eq!(decode(&stray).unwrap(), decode(data).unwrap());
    let many = [&data[..end], &[0x55; 40], &data[end..]].concat();
    assert!(matches!(check(&many), Err(JpegError::Damaged(_))));
}

proptest::proptest! {
    /// Changed bytes give a picture or an error.
    #[test]
    fn decoder_survives_changed_bytes(
        picture in 0_usize..200,
        changes in proptest::collection::vec((0_usize..2000, proptest::num::u8::ANY), 1..6),
    ) {
        let pictures = pictures();
        let mut data = pictures.into_values().nth(picture % 90).unwrap();
        for (at, value) in changes {
            let at = at % data.len();
            data[at] = value;
        }
        let _ = decode(&data);
    }
}
