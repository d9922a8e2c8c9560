use std::fs;

use image::{ImageFormat, Rgb, RgbImage};
use proptest::prelude::*;
use prost::Message as _;

use super::{
    example::{BytesList, Feature, Features, FloatList, Int64List, Kind},
    *,
};
use crate::{
    ImportOptions, import_bridge,
    testing::{assert_shards_join, of_shard},
};

fn feature(kind: Kind) -> Feature {
    Feature { kind: Some(kind) }
}

fn image_of(format: ImageFormat, texture: bool) -> Vec<u8> {
    let frame = RgbImage::from_fn(8, 8, |x, y| {
        if texture {
            Rgb([(x * 30) as u8, (y * 30) as u8, 90])
        } else {
            Rgb([0; 3])
        }
    });
    let mut bytes = std::io::Cursor::new(Vec::new());
    frame.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// An episode of `steps` steps with a JPEG camera, a PNG camera and a missing one.
fn example(steps: usize) -> Example {
    let images = |format, texture| {
        feature(Kind::Bytes(BytesList {
            value: vec![image_of(format, texture); steps],
        }))
    };
    let floats = |offset: f32| {
        let value = (0..steps * VALUES)
            .map(|number| (offset + number as f32) * 0.001)
            .collect();
        feature(Kind::Floats(FloatList { value }))
    };
    let features = [
        (ACTION.to_owned(), floats(0.0)),
        (STATE.to_owned(), floats(0.5)),
        (
            INSTRUCTION.to_owned(),
            feature(Kind::Bytes(BytesList {
                value: vec![b"open the drawer".to_vec(); steps],
            })),
        ),
        (format!("{IMAGE_PREFIX}0"), images(ImageFormat::Jpeg, true)),
        (format!("{IMAGE_PREFIX}1"), images(ImageFormat::Png, true)),
        (format!("{IMAGE_PREFIX}2"), images(ImageFormat::Jpeg, false)),
        (
            "steps/is_first".to_owned(),
            feature(Kind::Integers(Int64List {
                value: vec![0; steps],
            })),
        ),
    ];
    Example {
        features: Some(Features {
            feature: features.into(),
        }),
    }
}

fn tfrecord(examples: &[Example]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for example in examples {
        let data = example.encode_to_vec();
        let length = (data.len() as u64).to_le_bytes();
        bytes.extend(length);
        bytes.extend(tfrecord::masked_crc(&length).to_le_bytes());
        bytes.extend(&data);
        bytes.extend(tfrecord::masked_crc(&data).to_le_bytes());
    }
    bytes
}

fn read(bytes: &[u8]) -> Result<Vec<Episode>, ImportError> {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("made.tfrecord");
    fs::write(&file, bytes).unwrap();
    let mapping = ActionMapping::default();
    episodes(vec![file], 95)
        .map(|unread| unread?.read(&mapping))
        .collect()
}

#[test]
fn example_becomes_an_episode() {
    let read = read(&tfrecord(&[example(3), example(2)])).unwrap();
    assert_eq!(
        read.iter()
            .map(|episode| episode.recorded.actions.len())
            .collect::<Vec<_>>(),
        [3, 2]
    );
    let episode = &read[0];
    assert_eq!(
        episode.recorded.actions[1],
        [7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0].map(|value: f32| value * 0.001)
    );
    assert_eq!(episode.recorded.states[2][6], 20.5 * 0.001);
    assert_eq!(episode.instruction.as_deref(), Some("open the drawer"));
    assert_eq!(episode.cameras.len(), 2, "the flat camera is skipped");
    assert!(
        episode.notes[0].starts_with("image_2 shows one flat colour"),
        "{:?}",
        episode.notes
    );
    assert_eq!(
        episode.cameras[0].frames[0],
        image_of(ImageFormat::Jpeg, true),
        "JPEG bytes are kept"
    );
    assert_eq!(
        image::guess_format(&episode.cameras[1].frames[0]).unwrap(),
        ImageFormat::Jpeg,
        "PNG becomes JPEG"
    );
}

#[test]
fn incomplete_picture_is_an_error_that_names_its_step() {
    let jpeg = image_of(ImageFormat::Jpeg, true);
    let png = image_of(ImageFormat::Png, true);
    let depth = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(8, 8, image::Luma([900]));
    let mut grey = std::io::Cursor::new(Vec::new());
    depth.write_to(&mut grey, ImageFormat::Png).unwrap();
    let cut = |bytes: &[u8]| bytes[..bytes.len() - 20].to_vec();
    for (bytes, expected) in [
        (cut(&jpeg), "incomplete"),
        (cut(&png), "png"),
        (grey.into_inner(), "depth"),
        (b"GIF89a".to_vec(), "GIF"),
    ] {
        let error = Pictures::read(&[jpeg.clone(), bytes], 95).err().unwrap();
        assert!(
            error.starts_with("step 1: ") && error.contains(expected),
            "{error}"
        );
    }
}

#[test]
fn masked_crc_equals_that_of_tensorflow() {
    // CRC-32C of "123456789" is 0xe3069283 (RFC 3720, appendix B.4 gives the polynomial; the value is the standard check).
    assert_eq!(masked(0xe306_9283), tfrecord::masked_crc(b"123456789"));
}

/// The mask of tensorflow/core/lib/hash/crc32c.h.
fn masked(crc: u32) -> u32 {
    crc.rotate_right(15).wrapping_add(0xa282_ead8)
}

#[test]
fn invalid_features_are_named() {
    let error = |change: &dyn Fn(&mut Features)| {
        let mut changed = example(2);
        change(changed.features.as_mut().unwrap());
        let error = read(&tfrecord(&[example(1), changed]))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("made.tfrecord") && error.contains("episode 1"),
            "{error}"
        );
        error
    };
    assert!(error(&|features| drop(features.feature.remove(ACTION))).contains("steps/action"));
    assert!(
        error(&|features| {
            features.feature.insert(
                ACTION.into(),
                feature(Kind::Floats(FloatList {
                    value: vec![0.0; 13],
                })),
            );
        })
        .contains("rows of 7, got 13")
    );
    assert!(
        error(&|features| {
            features.feature.insert(
                format!("{IMAGE_PREFIX}0"),
                feature(Kind::Bytes(BytesList {
                    value: vec![vec![1, 2]; 2],
                })),
            );
        })
        .contains("image_0, step 0")
    );
    assert!(
        error(&|features| {
            let value = vec![image_of(ImageFormat::Jpeg, true)];
            features.feature.insert(
                format!("{IMAGE_PREFIX}0"),
                feature(Kind::Bytes(BytesList { value })),
            );
        })
        .contains("camera \"camera\" has 1 frames for 2 actions")
    );
}

#[test]
fn file_with_too_few_episodes_is_incomplete() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(
        dir.path().join("made-train.tfrecord-00000-of-00001"),
        tfrecord(&[example(1), example(1)]),
    )
    .unwrap();
    let import = |count: u64, out: &str| {
        let info = format!(
            r#"{{"splits": [{{"name": "train", "shardLengths": ["{count}"], "numBytes": "1"}}]}}"#
        );
        fs::write(dir.path().join("dataset_info.json"), info).unwrap();
        import_bridge(dir.path(), &dir.path().join(out), &ImportOptions::default())
    };
    assert_eq!(import(2, "a").unwrap().bags.len(), 2);
    let imported = import(3, "b").unwrap();
    assert_eq!(imported.bags.len(), 2);
    let reason = &imported.skipped[0];
    assert!(
        reason.contains("made-train.tfrecord") && reason.contains("expected 3 episodes"),
        "{reason}"
    );
    // Existing bags are not overwritten.
    assert!(matches!(
        import(2, "a"),
        Err(ImportError::Bag(wm_bag::BagError::Exists(_)))
    ));
}

#[test]
fn shards_import_the_same_as_one_run() {
    let dir = tempfile::tempdir().unwrap();
    let (src, out) = (dir.path().join("src"), dir.path().join("out"));
    let file = src.join("a.tfrecord");
    fs::create_dir(&src).unwrap();
    fs::write(&file, tfrecord(&[example(2), example(1), example(3)])).unwrap();
    fs::write(src.join("b.tfrecord"), tfrecord(&[example(1), example(2)])).unwrap();
    assert_shards_join(5, |out, options| import_bridge(&src, out, options));

    // A faulty episode of one shard does not affect the other.
    let mut damaged = fs::read(&file).unwrap();
    damaged[tfrecord(&[example(2)]).len() + 20] ^= 1;
    fs::write(&file, damaged).unwrap();
    let import = |index| import_bridge(&src, &out, &of_shard(index, 2));
    assert_eq!(import(0).unwrap().bags.len(), 3);
    let skipped = import(1).unwrap().skipped;
    assert!(skipped[0].contains("a.tfrecord"), "{skipped:?}");

    // A source without episodes is an error for every shard.
    for name in ["a.tfrecord", "b.tfrecord"] {
        fs::write(src.join(name), "").unwrap();
    }
    for index in 0..2 {
        assert!(matches!(import(index), Err(ImportError::NoEpisodes(_))));
    }
}

#[test]
fn interrupted_import_continues() {
    let dir = tempfile::tempdir().unwrap();
    let (src, out) = (dir.path().join("src"), dir.path().join("out"));
    fs::create_dir(&src).unwrap();
    let file = src.join("a.tfrecord");
    fs::write(&file, tfrecord(&[example(2), example(1), example(3)])).unwrap();
    let resuming = ImportOptions {
        resume: true,
        ..ImportOptions::default()
    };
    let first = ImportOptions {
        episodes: Some(2),
        ..resuming.clone()
    };
    let made = import_bridge(&src, &out, &first).unwrap();
    assert_eq!((made.bags.len(), made.kept), (2, 0));
    let modified = |bag: &str| {
        let metadata = out.join(bag).join("metadata.yaml");
        fs::metadata(metadata).unwrap().modified().unwrap()
    };
    let before = modified("episode_000000");
    let whole = import_bridge(&src, &out, &resuming).unwrap();
    assert_eq!((whole.bags.len(), whole.kept), (3, 2));
    assert_eq!(modified("episode_000000"), before);
    // Without the option, or of another data set, existing bags are an error.
    for (src, options) in [(&src, ImportOptions::default()), (&file, resuming)] {
        let error = import_bridge(src, &out, &options).unwrap_err().to_string();
        assert!(error.contains("episode_000000"), "{error}");
    }
}

fn floats(value: Vec<f32>) -> Feature {
    feature(Kind::Floats(FloatList { value }))
}

fn texts(text: &str, steps: usize) -> Feature {
    let value = vec![text.as_bytes().to_vec(); steps];
    feature(Kind::Bytes(BytesList { value }))
}

/// DROID's public layout: a rotation of 0.05 rad about the base's x at pitch 80 degrees, with absolute actions.
fn droid_example(steps: usize) -> Example {
    let images = || {
        feature(Kind::Bytes(BytesList {
            value: vec![image_of(ImageFormat::Jpeg, true); steps],
        }))
    };
    let pose = |step: usize| {
        [
            0.3 + 0.01 * step as f32,
            0.1,
            0.3,
            0.1,
            0.2,
            0.05 * step as f32,
        ]
    };
    let poses: Vec<f32> = (0..steps).flat_map(pose).collect();
    let action = |step: usize| {
        let [x, y, z, roll, pitch, yaw] = pose(step);
        [x, y, z, roll, pitch, yaw, 0.0]
    };
    let reward: Vec<f32> = (0..steps)
        .map(|step| f32::from(step + 1 == steps))
        .collect();
    let features = [
        (ACTION, floats((0..steps).flat_map(action).collect())),
        ("steps/observation/cartesian_position", floats(poses)),
        (
            "steps/observation/gripper_position",
            floats((0..steps).map(|s| (s % 2) as f32).collect()),
        ),
        (
            "steps/observation/joint_position",
            floats(vec![0.5; steps * 7]),
        ),
        ("steps/observation/exterior_image_1_left", images()),
        ("steps/observation/exterior_image_2_left", images()),
        ("steps/observation/wrist_image_left", images()),
        ("steps/language_instruction", texts("", steps)),
        ("steps/language_instruction_2", texts("pick the cup", steps)),
        ("steps/reward", floats(reward)),
    ];
    let feature = features
        .map(|(name, feature)| (name.to_owned(), feature))
        .into();
    Example {
        features: Some(Features { feature }),
    }
}

#[test]
fn droid_actions_are_computed_from_its_states() {
    let read = read(&tfrecord(&[droid_example(5)])).unwrap();
    let episode = &read[0];
    assert_eq!(episode.recorded.period_ns, 66_666_667);
    let names: Vec<&str> = episode
        .cameras
        .iter()
        .map(|camera| camera.name.as_str())
        .collect();
    assert_eq!(names, ["exterior_1", "exterior_2", "wrist"]);
    assert_eq!(episode.instruction.as_deref(), Some("pick the cup"));
    assert_eq!(episode.success, Some(true));
    let joints = episode.joints.as_ref().unwrap();
    assert_eq!(
        (joints.names[0].as_str(), joints.positions.len()),
        ("panda_joint1", 5)
    );
    // Not the absolute pose of the release; the gripper is inverted to Bridge V2's sense.
    let expected = [0.01, 0.0, 0.0, 0.0, 0.0, 0.05, 0.0];
    for (found, expected) in episode.recorded.actions[0].iter().zip(expected) {
        assert!(
            (found - expected).abs() < 1e-5,
            "{:?}",
            episode.recorded.actions[0]
        );
    }
    assert_eq!(episode.recorded.states[0][6], 1.0, "0 is open");
}

#[test]
fn success_is_the_last_reward_of_a_whole_episode() {
    let success = |features: &[(&str, Feature)]| {
        let mut example = example(3);
        for (name, feature) in features {
            let all = &mut example.features.as_mut().unwrap().feature;
            all.insert((*name).to_owned(), feature.clone());
        }
        read(&tfrecord(&[example])).unwrap()[0].success
    };
    let whole = |value: Vec<i64>| feature(Kind::Integers(Int64List { value }));
    let reward = |last: f32| (REWARD, floats(vec![0.0, 0.0, last]));
    assert_eq!(success(&[]), None);
    assert_eq!(success(&[reward(1.0)]), Some(true));
    assert_eq!(success(&[reward(0.0)]), Some(false));
    assert_eq!(
        success(&[reward(0.0), (IS_LAST, whole(vec![0, 0, 1]))]),
        Some(false)
    );
    // A part of an episode does not show its end.
    assert_eq!(
        success(&[reward(0.0), (IS_LAST, whole(vec![0, 0, 0]))]),
        None
    );
    assert_eq!(
        success(&[reward(0.0), (SUCCESS, whole(vec![1]))]),
        Some(true)
    );
}

#[test]
fn contradicting_actions_are_rejected_with_the_option() {
    let dir = tempfile::tempdir().unwrap();
    let import = |name: &str, rows: &[[f32; VALUES]], mapping: ActionMapping| {
        let src = dir.path().join(name);
        fs::create_dir_all(&src).unwrap();
        let mut example = example(rows.len());
        let all = &mut example.features.as_mut().unwrap().feature;
        all.insert(ACTION.to_owned(), floats(rows.concat()));
        all.remove(STATE);
        fs::write(src.join("a.tfrecord"), tfrecord(&[example])).unwrap();
        let options = ImportOptions {
            actions: mapping,
            ..ImportOptions::default()
        };
        let out = tempfile::tempdir().unwrap();
        let imported = import_bridge(&src, &out.path().join("out"), &options);
        imported
            .map(|imported| imported.bags.len())
            .map_err(|error| error.to_string())
    };
    let plain = ActionMapping::default();
    let grippers = [-1.0, 0.0, 1.0].map(|gripper| [0.003, 0.0, 0.0, 0.0, 0.0, 0.0, gripper]);
    let error = import("gripper", &grippers, plain).unwrap_err();
    assert!(
        error.contains("gripper: measured -1 to 1; expected 0 (closed) to 1 (open)")
            && error.contains("--gripper-range -1:1"),
        "{error}"
    );
    let mapped = ActionMapping {
        gripper: Some("-1:1".parse().unwrap()),
        ..plain
    };
    assert_eq!(import("gripper", &grippers, mapped), Ok(1));
    let poses: Vec<[f32; VALUES]> = (0..12)
        .map(|step| [0.3 + 0.01 * step as f32, 0.1, 0.3, 3.1, 0.0, 0.2, 1.0])
        .collect();
    let error = import("poses", &poses, plain).unwrap_err();
    assert!(
        error.contains("dx: measured 0.3 to 0.41 m") && error.contains("--actions absolute"),
        "{error}"
    );
    let absolute = ActionMapping {
        form: crate::ActionForm::Absolute,
        ..plain
    };
    assert_eq!(import("poses", &poses, absolute), Ok(1));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn truncated_or_damaged_file_is_an_error(cut in 0.0f64..1.0, flip in 0.0f64..1.0, bits in 1u8..=255) {
        let bytes = tfrecord(&[example(2), example(1)]);
        let first = tfrecord(&[example(2)]).len();
        let place = |share: f64| (share * bytes.len() as f64) as usize;
        let end = place(cut);
        match read(&bytes[..end]) {
            Ok(read) => prop_assert!((end, read.len()) == (0, 0) || (end, read.len()) == (first, 1)),
            Err(error) => prop_assert!(error.to_string().contains("made.tfrecord")),
        }
        let mut damaged = bytes.clone();
        damaged[place(flip)] ^= bits;
        prop_assert!(read(&damaged).is_err());
    }
}
