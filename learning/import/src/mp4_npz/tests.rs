use std::{
    fs,
    io::{Cursor, Write as _},
    path::Path,
};

use ::mp4::{
    AvcConfig, Bytes, MediaConfig, Mp4Config, Mp4Sample, Mp4Writer, TrackConfig, TrackType,
};
use image::{ImageFormat, Rgb, RgbImage};
use npyz::WriterBuilder as _;
use openh264::{
    encoder::Encoder,
    formats::{RgbSliceU8, YUVBuffer},
};
use proptest::prelude::*;
use zip::{ZipWriter, write::SimpleFileOptions};

use super::*;
use crate::{
    ImportOptions, import_bridge,
    mapping::VALUES,
    testing::{assert_shards_join, shard},
};

/// Frame `number`: a bright square that moves over a gradient.
fn frame(number: u32) -> RgbImage {
    RgbImage::from_fn(64, 48, |x, y| {
        if (x / 16, y / 16) == (number % 4, 1) {
            Rgb([250, 220, 40])
        } else {
            Rgb([40, (x * 3) as u8, 120])
        }
    })
}

/// The NAL units of an elementary stream, without their start codes.
fn nal_units(stream: &[u8]) -> Vec<Vec<u8>> {
    openh264::nal_units(stream)
        .map(|unit| unit[unit.iter().position(|byte| *byte == 1).unwrap() + 1..].to_vec())
        .collect()
}

pub(crate) fn video(frames: u32) -> Vec<u8> {
    let mut encoder = Encoder::new().unwrap();
    let mut writer = None;
    for number in 0..frames {
        let rgb = frame(number);
        let picture = YUVBuffer::from_rgb8_source(RgbSliceU8::new(rgb.as_raw(), (64, 48)));
        let stream = encoder.encode(&picture).unwrap().to_vec();
        let (parameters, picture): (Vec<_>, Vec<_>) = nal_units(&stream)
            .into_iter()
            .partition(|unit| matches!(unit[0] & 31, 7 | 8));
        let writer = writer.get_or_insert_with(|| {
            let brand = str::parse("isom").unwrap();
            let config = Mp4Config {
                major_brand: brand,
                minor_version: 0,
                compatible_brands: vec![brand],
                timescale: 1000,
            };
            let mut writer = Mp4Writer::write_start(Cursor::new(Vec::new()), &config).unwrap();
            let find = |kind: u8| {
                parameters
                    .iter()
                    .find(|unit| unit[0] & 31 == kind)
                    .unwrap()
                    .clone()
            };
            let avc = AvcConfig {
                width: 64,
                height: 48,
                seq_param_set: find(7),
                pic_param_set: find(8),
            };
            writer
                .add_track(&TrackConfig {
                    track_type: TrackType::Video,
                    timescale: 1000,
                    language: "und".into(),
                    media_conf: MediaConfig::AvcConfig(avc),
                })
                .unwrap();
            writer
        });
        let bytes: Vec<u8> = picture
            .iter()
            .flat_map(|unit| {
                (unit.len() as u32)
                    .to_be_bytes()
                    .into_iter()
                    .chain(unit.iter().copied())
            })
            .collect();
        let sample = Mp4Sample {
            start_time: u64::from(number) * 200,
            duration: 200,
            rendering_offset: 0,
            is_sync: number == 0,
            bytes: Bytes::from(bytes),
        };
        writer.write_sample(1, &sample).unwrap();
    }
    let mut writer = writer.unwrap();
    writer.write_end().unwrap();
    writer.into_writer().into_inner()
}

/// An `.npz` with rows of `columns` scaled values.
fn npz(name: &str, columns: u64, rows: &[Vec<f32>]) -> Vec<u8> {
    let mut array = Vec::new();
    let mut writer = npyz::WriteOptions::new()
        .default_dtype()
        .shape(&[rows.len() as u64, columns])
        .writer(&mut array)
        .begin_nd()
        .unwrap();
    writer.extend(rows.concat()).unwrap();
    writer.finish().unwrap();
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    archive
        .start_file(format!("{name}.npy"), SimpleFileOptions::default())
        .unwrap();
    archive.write_all(&array).unwrap();
    archive.finish().unwrap().into_inner()
}

/// An `.npz` with labels: arrays of one element, as NumPy writes them.
fn labelled(labels: &[(&str, &str, Vec<u8>)]) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let mut member = |name: &str, bytes: &[u8]| {
        let name = format!("{name}.npy");
        archive
            .start_file(name, SimpleFileOptions::default())
            .unwrap();
        archive.write_all(bytes).unwrap();
    };
    let values: Vec<u8> = rows(3)
        .concat()
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    member("actions", &npy("<f4", "(3, 10)", &values));
    for (name, dtype, bytes) in labels {
        member(name, &npy(dtype, "()", bytes));
    }
    archive.finish().unwrap().into_inner()
}

/// An array in NumPy's format 1.0 (numpy.lib.format).
fn npy(dtype: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

#[test]
fn labels_of_the_authors_downloader_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let utf32 = |text: &str| {
        text.chars()
            .flat_map(|c| u32::from(c).to_le_bytes())
            .collect()
    };
    let video = video(3);
    let labels = |labels: &[(&str, &str, Vec<u8>)]| {
        let episode = read(dir.path(), &video, &labelled(labels));
        episode.map_err(|error| error.to_string())
    };
    for (success, dtype, bytes) in [
        (Some(true), "|b1", vec![1]),
        (Some(false), "|b1", vec![0]),
        (Some(true), "<i8", 1i64.to_le_bytes().to_vec()),
        (Some(true), ">f4", 1f32.to_be_bytes().to_vec()),
    ] {
        let text = ("language_instruction", "<U9", utf32("öffne sie"));
        let episode = labels(&[("success", dtype, bytes), text]).unwrap();
        assert_eq!(episode.success, success, "{dtype}");
        assert_eq!(episode.instruction.as_deref(), Some("öffne sie"));
        assert_eq!(episode.notes, [""; 0]);
    }
    let padded = ("language_instruction", "|S6", b"lift\0\0".to_vec());
    let more = ("goal", "<f4", vec![0; 4]);
    let episode = labels(&[padded, more]).unwrap();
    assert_eq!(episode.instruction.as_deref(), Some("lift"));
    assert_eq!(episode.success, None);
    assert_eq!(episode.notes, ["arrays without a topic are ignored: goal"]);
    let pickled = labels(&[("language_instruction", "|O", vec![128, 4])]).unwrap();
    assert!(pickled.notes[0].contains("pickled"), "{:?}", pickled.notes);
    for (error, part) in [
        (
            labels(&[("success", "<f4", 0.5f32.to_le_bytes().to_vec())]),
            "success: expected 0 or 1, got 0.5",
        ),
        (
            labels(&[("success", "<U1", utf32("y"))]),
            "success: expected 0 or 1, got \"y\"",
        ),
        (
            labels(&[("language_instruction", "<U9", vec![0; 8])]),
            "it is cut short",
        ),
        (
            labels(&[("language_instruction", "|b1", vec![1])]),
            "expected a text, got 1",
        ),
    ] {
        let error = error.unwrap_err();
        assert!(
            error.contains("made.npz") && error.contains(part),
            "{error}"
        );
    }
}

#[test]
fn incomplete_pair_is_skipped_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let (src, out) = (dir.path().join("src"), dir.path().join("out"));
    fs::create_dir(&src).unwrap();
    for name in ["a", "b", "c"] {
        fs::write(src.join(name).with_extension("mp4"), video(3)).unwrap();
        let npz = npz("actions", 10, &rows(3));
        fs::write(src.join(name).with_extension("npz"), npz).unwrap();
    }
    fs::remove_file(src.join("b.npz")).unwrap();
    let imported = import_bridge(&src, &out, &ImportOptions::default()).unwrap();
    assert_eq!(
        imported.bags,
        ["episode_000000", "episode_000002"].map(|bag| out.join(bag))
    );
    assert!(
        imported.skipped[0].contains("b.npz is missing"),
        "{:?}",
        imported.skipped
    );
    let ranges = imported.ranges.unwrap();
    assert!(
        ranges.starts_with("actions of 2 episodes at 5 Hz: dx 0.01 to 0.01 m"),
        "{ranges}"
    );
}

fn scaled(gripper: f32) -> Vec<f32> {
    vec![0.35, -0.7, 1.05, 0.56, -1.12, 0.0, gripper, 0.0, 0.0, 0.0]
}

fn read(dir: &Path, video: &[u8], npz: &[u8]) -> Result<Episode, ImportError> {
    let (video_file, actions_file) = (dir.join("made.mp4"), dir.join("made.npz"));
    fs::write(&video_file, video).unwrap();
    fs::write(&actions_file, npz).unwrap();
    let unread = episodes(vec![(video_file, actions_file)], 95).next();
    unread.unwrap()?.read(&ActionMapping::default())
}

fn rows(count: usize) -> Vec<Vec<f32>> {
    (0..count)
        .map(|row| scaled(if row % 2 == 0 { -1.0 } else { 1.0 }))
        .collect()
}

#[test]
fn video_with_actions_becomes_an_episode() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["arr_0", "actions"] {
        let episode = read(dir.path(), &video(6), &npz(name, 10, &rows(6))).unwrap();
        assert_eq!(episode.recorded.actions.len(), 6);
        let expected = [0.01, -0.02, 0.03, 0.1, -0.2, 0.0, 1.0];
        for (value, expected) in episode.recorded.actions[0].iter().zip(expected) {
            assert!(
                (value - expected).abs() < 1e-6,
                "{:?}",
                episode.recorded.actions[0]
            );
        }
        assert_eq!(episode.recorded.actions[1][VALUES - 1], 0.0, "+1 is closed");
        for (number, jpeg) in episode.cameras[0].frames.iter().enumerate() {
            let decoded = image::load_from_memory_with_format(jpeg, ImageFormat::Jpeg)
                .unwrap()
                .into_rgb8();
            let shown = frame(number as u32);
            let error: f64 = decoded
                .as_raw()
                .iter()
                .zip(shown.as_raw())
                .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
                .sum::<f64>()
                / decoded.as_raw().len() as f64;
            // The moving square alone would exceed this; the rest is loss of h264 and of chroma at half resolution.
            assert!(error < 400.0, "frame {number}: mean squared error {error}");
        }
    }
}

#[test]
fn invalid_files_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let (good_video, good_npz) = (video(3), npz("arr_0", 10, &rows(3)));
    let error = |video: &[u8], npz: &[u8]| read(dir.path(), video, npz).unwrap_err().to_string();
    for (text, part) in [
        (
            error(&good_video, &npz("arr_0", 10, &rows(2))),
            "camera \"camera\" has 3 frames for 2 actions",
        ),
        (
            error(&good_video, &npz("other", 10, &rows(3))),
            "made.npz: expected an array named actions or arr_0",
        ),
        (
            error(&good_video, &npz("arr_0", 7, &vec![vec![0.0; 7]; 3])),
            "made.npz: expected arr_0.npy of shape (T, 10)",
        ),
        (
            error(&good_video, &npz("arr_0", 10, &vec![scaled(3.0); 3])),
            "row 0: expected the gripper",
        ),
        (
            error(&good_video, &npz("arr_0", 10, &vec![vec![0.5; 10]; 3])),
            "row 0: expected zeros",
        ),
        (
            error(&good_video, &good_npz[..good_npz.len() / 2]),
            "made.npz: not an npz",
        ),
        (error(b"not a video", &good_npz), "made.mp4: not an mp4"),
        (error(b"", &good_npz), "made.mp4: not an mp4"),
    ] {
        assert!(text.contains(part), "{part:?} in {text:?}");
    }
}

#[test]
fn shards_import_the_same_as_one_run() {
    let dir = tempfile::tempdir().unwrap();
    let (src, out) = (dir.path().join("src"), dir.path().join("out"));
    fs::create_dir(&src).unwrap();
    for (frames, name) in [(2, "a"), (3, "b"), (4, "c"), (5, "d"), (2, "e")] {
        fs::write(src.join(name).with_extension("mp4"), video(frames)).unwrap();
        let npz = npz("actions", 10, &rows(frames as usize));
        fs::write(src.join(name).with_extension("npz"), npz).unwrap();
    }
    assert_shards_join(5, |out, options| import_bridge(&src, out, options));

    // A faulty episode of one shard does not affect the other, and the limit is that of one run.
    fs::write(src.join("b.mp4"), "not a video").unwrap();
    let import = |index| {
        let options = ImportOptions {
            shard: shard(index, 2),
            episodes: Some(4),
            ..ImportOptions::default()
        };
        import_bridge(&src, &out, &options)
    };
    let bags = ["episode_000000", "episode_000002"].map(|bag| out.join(bag));
    assert_eq!(import(0).unwrap().bags, bags);
    let imported = import(1).unwrap();
    assert_eq!(imported.bags, [out.join("episode_000003")]);
    assert!(imported.skipped[0].contains("b.mp4"), "{imported:?}");
}

#[test]
fn truncated_video_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let (video, npz) = (video(3), npz("arr_0", 10, &rows(3)));
    for end in (0..video.len()).step_by(7) {
        let error = read(dir.path(), &video[..end], &npz)
            .unwrap_err()
            .to_string();
        assert!(error.contains("made.mp4"), "cut at {end}: {error}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn damaged_files_give_an_episode_or_an_error(
        flips in prop::collection::vec((0.0f64..1.0, 1u8..=255), 1..6),
        in_video in any::<bool>(),
    ) {
        let dir = tempfile::tempdir().unwrap();
        let (mut video, mut npz) = (video(2), npz("arr_0", 10, &rows(2)));
        let damaged = if in_video { &mut video } else { &mut npz };
        for (share, bits) in flips {
            let at = (share * damaged.len() as f64) as usize;
            damaged[at] ^= bits;
        }
        // Few cases hit the container's index or the codec's parameters; the test holds that no case ends the process.
        let result = read(dir.path(), &video, &npz);
        if let Ok(episode) = result {
            prop_assert_eq!(episode.cameras[0].frames.len(), episode.recorded.actions.len());
        }
    }
}
