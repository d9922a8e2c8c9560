mod audit;
mod cutting;
mod fit;
mod folder;
mod options;
mod outcome;
mod robots;
mod video;

use std::path::Path;

use image::{Rgb, RgbImage};
use wm_bag::{BagWriter, WriterOptions};
use wm_msgs::{
    builtin_interfaces::Time, sensor_msgs::CompressedImage, std_msgs::Header, wm_msgs::Action,
};

use super::*;
use crate::testing::{Contents, PERIOD_NS, WHOLE, header, png, write_bag};

#[test]
fn data_keep_their_order_and_come_from_the_cache() {
    let dir = tempfile::tempdir().unwrap();
    let bags = dir.path().join("bags");
    write_bag(&bags.join("episode_000000"), 3, &WHOLE);
    write_bag(&bags.join("episode_000001"), 4, &WHOLE);
    let cache = dir.path().join("cache");
    let first = Dataset::open(&bags, &cache, (16, 16)).unwrap();
    let caches = || std::fs::read_dir(&cache).unwrap().count();
    assert_eq!(caches(), 1);
    for dataset in [first, Dataset::open(&bags, &cache, (16, 16)).unwrap()] {
        assert_eq!(dataset.frame_count(), 7);
        let second = &dataset.episodes()[1];
        assert_eq!((second.first_frame, second.frame_count), (3, 4));
        let firsts: Vec<f32> = second.actions.iter().map(|action| action[0]).collect();
        assert_eq!(firsts, [0., 0.125, 0.25, 0.25]);
        assert_eq!(dataset.frame(5).unwrap()[..3], [20, 20, 30]);
        assert_eq!(dataset.mask(6).unwrap(), [3; 256]);
        let labels = second.labels.iter().map(|(value, name)| (*value, &**name));
        let labels: Vec<(u8, &str)> = labels.collect();
        assert_eq!(labels, [(1, "gripper"), (2, "red ball"), (3, "blue box")]);
        assert!(dataset.frame(7).is_none());
    }
    assert_eq!(caches(), 1, "the second run used the cache");

    // New contents under the same names are another data set.
    let file = bags.join("episode_000000/episode_000000_0.mcap");
    let mut bytes = std::fs::read(&file).unwrap();
    bytes.push(0);
    std::fs::write(&file, bytes).unwrap();
    Dataset::open(&bags, &cache, (16, 16)).unwrap();
    assert_eq!(caches(), 2);
}

#[test]
fn each_bag_is_prepared_once_for_all_selections() {
    let dir = tempfile::tempdir().unwrap();
    let bags: Vec<_> = (0..3)
        .map(|i| dir.path().join(format!("bag_{i}")))
        .collect();
    for (frames, bag) in (3..).zip(&bags) {
        write_bag(bag, frames, &WHOLE);
    }
    let without_actions = Contents {
        actions: false,
        ..WHOLE
    };
    let empty = dir.path().join("bag_empty");
    write_bag(&empty, 3, &without_actions);
    let cache = dir.path().join("cache");
    let options = DataOptions {
        validation: Some(0.0),
        by_bag: true,
        ..DataOptions::default()
    };
    let open = |bags: &[std::path::PathBuf]| Data::open(bags, (16, 16), &cache, &options);
    let caches = || -> Vec<String> {
        let entries = std::fs::read_dir(&cache).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name());
        names.map(|name| name.into_string().unwrap()).collect()
    };
    let first = open(&[bags[0].clone(), empty.clone(), bags[1].clone()]).unwrap();
    assert_eq!(first.training.frame_count(), 3 + 4);
    assert_eq!(caches().len(), 2);
    let later = open(&bags[1..]).unwrap().training;
    assert_eq!(later.frame_count(), 4 + 5);
    assert_eq!(caches().len(), 3);
    assert_eq!(
        caches()
            .iter()
            .filter(|name| later.is_cached_as(name))
            .count(),
        2
    );
    assert!(matches!(open(&[empty]), Err(DatasetError::Nothing(_))));
}

#[test]
fn missing_inputs_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let refusal = |name: &str, contents: &Contents| {
        let bags = dir.path().join(name);
        write_bag(&bags.join("episode_000007"), 3, contents);
        let error = Dataset::open(&bags, &dir.path().join("cache"), (16, 16)).unwrap_err();
        error.to_string()
    };
    let blind = refusal(
        "blind",
        &Contents {
            camera: false,
            masks: false,
            ..WHOLE
        },
    );
    assert!(
        blind.contains("episode_000007") && blind.contains("no camera"),
        "{blind}"
    );
    let idle = refusal(
        "idle",
        &Contents {
            actions: false,
            ..WHOLE
        },
    );
    assert!(
        idle.contains("episode_000007") && idle.contains("/wm/action"),
        "{idle}"
    );
    let empty = dir.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    let error = Dataset::open(&empty, dir.path(), (16, 16)).unwrap_err();
    assert!(matches!(error, DatasetError::Empty(_)), "{error}");
}

/// One motion recorded at another rate: 0.01 m and 0.1 rad per frame of 5 Hz.
fn write_at(dir: &Path, hertz: i64, space: Option<&str>) {
    let mut writer = BagWriter::create(dir, WriterOptions::default()).unwrap();
    if let Some(space) = space {
        writer.note(ActionSpace::NOTE, space);
    }
    for tick in 0..2 * hertz {
        let at_ns = tick * 1_000_000_000 / hertz;
        let header = Header {
            stamp: Time::from_nanos(at_ns),
            frame_id: String::new(),
        };
        let frame = RgbImage::from_pixel(16, 16, Rgb([10, 20, 30]));
        let picture = CompressedImage {
            header: header.clone(),
            format: "png".into(),
            data: png(frame.into()),
        };
        let share = 5.0 / hertz as f32;
        let action = Action {
            header,
            values: vec![0.01 * share, 0., 0., 0., 0., 0.1 * share, 1.],
        };
        writer
            .write("/camera/image_raw/compressed", &picture, at_ns as u64)
            .unwrap();
        writer.write("/wm/action", &action, at_ns as u64).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn bag_rate_does_not_matter() {
    let dir = tempfile::tempdir().unwrap();
    let actions_at = |hertz: i64| {
        let bags = dir.path().join(format!("{hertz}"));
        write_at(&bags.join("episode"), hertz, None);
        let dataset = Dataset::open(&bags, &dir.path().join("cache"), (16, 16)).unwrap();
        dataset.episodes()[0].actions.clone()
    };
    let expected = actions_at(5);
    assert_eq!(expected.len(), 10);
    for hertz in [10, 30, 50] {
        let found = actions_at(hertz);
        assert_eq!(found.len(), expected.len(), "{hertz} Hz");
        for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
            assert!(
                (found - expected).abs() < 1e-5,
                "{hertz} Hz: {found} {expected}"
            );
        }
    }
}

#[test]
fn camera_slower_than_the_model_is_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let bags = dir.path().join("bags");
    write_at(&bags.join("slow"), 1, None);
    let error = Dataset::open(&bags, &dir.path().join("cache"), (16, 16)).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("slow") && text.contains("every 1.00 s"),
        "{text}"
    );
}

#[test]
fn different_robots_are_rejected_with_the_difference() {
    let dir = tempfile::tempdir().unwrap();
    let bags = dir.path().join("bags");
    write_at(&bags.join("a"), 5, None);
    let joint = r#"{"name": "elbow", "unit": "rad", "kind": "joint_delta"}"#;
    let space = format!(r#"{{"name": "one_joint", "dimensions": [{joint}]}}"#);
    write_at(&bags.join("b"), 5, Some(&space));
    let cache = dir.path().join("cache");
    let text = Dataset::open(&bags, &cache, (16, 16))
        .unwrap_err()
        .to_string();
    assert!(
        text.contains("bridge_v2: dx") && text.contains("one_joint: elbow"),
        "{text}"
    );
    let odd = dir.path().join("odd");
    write_at(
        &odd.join("c"),
        5,
        Some(r#"{"name": "x", "dimensions": []}"#),
    );
    let text = Dataset::open(&odd, &cache, (16, 16))
        .unwrap_err()
        .to_string();
    assert!(text.contains("0 dimensions"), "{text}");
}

#[test]
fn raw_pictures_of_every_encoding_and_step_are_read() {
    let dir = tempfile::tempdir().unwrap();
    // One pixel of red, green and blue in each encoding; rows are padded by 5 bytes.
    let encodings: [(&str, &[u8], [u8; 3]); 6] = [
        ("rgb8", &[10, 20, 30], [10, 20, 30]),
        ("bgr8", &[30, 20, 10], [10, 20, 30]),
        ("rgba8", &[10, 20, 30, 255], [10, 20, 30]),
        ("bgra8", &[30, 20, 10, 255], [10, 20, 30]),
        ("mono8", &[40], [40; 3]),
        ("8UC3", &[30, 20, 10], [10, 20, 30]),
    ];
    for (encoding, pixel, rgb) in encodings {
        let bag = dir.path().join(encoding);
        let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
        for index in 0..3 {
            let at = (index * PERIOD_NS) as u64;
            let row = [pixel.repeat(16), vec![0; 5]].concat();
            let image = wm_msgs::sensor_msgs::Image {
                header: header(index),
                height: 16,
                width: 16,
                encoding: encoding.into(),
                step: row.len() as u32,
                data: row.repeat(16),
                ..Default::default()
            };
            writer.write("/camera/image_raw", &image, at).unwrap();
            let action = Action {
                header: header(index),
                values: vec![0.; 7],
            };
            writer.write("/wm/action", &action, at).unwrap();
        }
        writer.finish().unwrap();
        let dataset = Dataset::open(&bag, &dir.path().join("cache"), (16, 16)).unwrap();
        assert_eq!(dataset.frame(0), Some(&*rgb.repeat(16 * 16)), "{encoding}");
    }
}
