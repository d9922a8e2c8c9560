//! Interoperability with pyarrow and FFmpeg (PyAV) from PyPI, in the virtual environment that `tests/setup_ros2` makes.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use image::RgbImage;
use serde_json::{Value, json};
use tempfile::TempDir;
use wm_import::lerobot::{ExportOptions, ImportOptions, export, import};
use wm_msgs::{
    sensor_msgs::{CompressedImage, JointState},
    std_msgs::String as Text,
    wm_msgs::Action,
};

use super::made::{Episode, messages};

/// Runs a Python program of `tests/interop`; `None` (with a plain message) if its libraries are not installed.
fn peer(script: &str, arg: &Path) -> Option<Value> {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let python = root.join(".venv/tools/bin/python");
    if !python.is_file() {
        eprintln!(
            "skipped: no pyarrow and PyAV under .venv/tools; run tests/setup_ros2 (tests/run does)"
        );
        assert!(
            std::env::var_os("CI").is_none(),
            "the interoperability tests may not be skipped in CI"
        );
        return None;
    }
    let output = Command::new(python)
        .arg(root.join("tests/interop").join(script))
        .arg(arg)
        // The wheels of ROS 2 set it; it would load their libraries into this Python.
        .env_remove("LD_LIBRARY_PATH")
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "{script} {}: {errors}",
        arg.display()
    );
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

#[test]
fn other_readers_read_exports() {
    let scratch = TempDir::new().unwrap();
    let episodes = [
        Episode::made(7, 0.0),
        Episode::made(4, -3.0),
        Episode::made(9, 0.5),
    ];
    let bags: Vec<PathBuf> = (0..episodes.len())
        .map(|n| scratch.path().join(format!("bag_{n}")))
        .collect();
    for (episode, bag) in episodes.iter().zip(&bags) {
        episode.write(bag);
    }
    let plain = ExportOptions {
        robot_type: Some("widowx".into()),
        ..ExportOptions::default()
    };
    let split = ExportOptions {
        data_file_bytes: 1,
        video_file_bytes: 1,
        ..plain.clone()
    };
    for (name, options) in [("plain", plain), ("split", split)] {
        let dataset = scratch.path().join(name);
        export(&bags, &dataset, &options).unwrap();
        let Some(seen) = peer("lerobot_check.py", &dataset) else {
            return;
        };
        assert_eq!(seen["info"]["robot_type"], "widowx");
        assert_eq!(seen["info"]["fps"], 5);
        assert_eq!(seen["tasks"], json!(["lift the lid"]));
        for (episode, seen) in episodes.iter().zip(seen["episodes"].as_array().unwrap()) {
            let columns = &seen["columns"];
            let actions: Vec<Vec<f32>> = serde_json::from_value(columns["action"].clone()).unwrap();
            assert_eq!(actions, episode.actions);
            let states: Vec<Vec<f32>> =
                serde_json::from_value(columns["observation.state"].clone()).unwrap();
            for (frame, state) in states.iter().enumerate() {
                assert_eq!(state[..2], episode.joints[frame]);
                assert_eq!(state[9], episode.grippers[frame]);
            }
            let successes = columns["next.success"].as_array().unwrap();
            assert_eq!(
                successes
                    .iter()
                    .filter(|success| **success == json!(true))
                    .count(),
                1
            );
            assert_eq!(successes.last(), Some(&json!(true)));
            assert_eq!(seen["videos"].as_object().unwrap().len(), 2);
        }
    }
}

/// Mean colour of each quarter.
fn quarters(rgb: &RgbImage) -> [[f64; 3]; 4] {
    let (half_width, half_height) = (rgb.width() / 2, rgb.height() / 2);
    let mut sums = [[0.0; 3]; 4];
    for (x, y, pixel) in rgb.enumerate_pixels() {
        let quarter = usize::from(x >= half_width) + 2 * usize::from(y >= half_height);
        for (sum, value) in sums[quarter].iter_mut().zip(pixel.0) {
            *sum += f64::from(value) / f64::from(half_width * half_height);
        }
    }
    sums
}

#[test]
fn data_sets_of_other_writers_are_imported() {
    let scratch = TempDir::new().unwrap();
    let Some(written) = peer("lerobot_write.py", scratch.path()) else {
        return;
    };
    let written = written.as_array().unwrap();
    for version in ["v21", "v30"] {
        let out = scratch.path().join(format!("{version}_bags"));
        let bags = import(
            &scratch.path().join(version),
            &out,
            &ImportOptions::default(),
        )
        .unwrap()
        .bags;
        assert_eq!(bags.len(), written.len());
        for (bag, episode) in bags.iter().zip(written) {
            let actions: Vec<Action> = messages(bag, "/wm/action");
            let expected: Vec<Vec<f32>> =
                serde_json::from_value(episode["action"].clone()).unwrap();
            assert!(
                actions.iter().map(|action| &action.values).eq(&expected),
                "{version}"
            );
            for (frame, action) in actions.iter().enumerate() {
                let stamp_ns = 1_700_000_000_000_000_000 + frame as i64 * 100_000_000;
                assert_eq!(action.header.stamp.to_nanos(), stamp_ns, "{version}");
            }
            let states: Vec<JointState> = messages(bag, "/joint_states");
            // In single precision: a double in text may differ in its last bit.
            let expected: Vec<Vec<f32>> = serde_json::from_value(episode["state"].clone()).unwrap();
            for (state, expected) in states.iter().zip(&expected) {
                let position: Vec<f32> = state.position.iter().map(|value| *value as f32).collect();
                assert_eq!(&position, expected, "{version}");
            }
            assert_eq!(states.len(), expected.len());
            assert_eq!(states[0].name, ["shoulder.pos", "elbow.pos", "gripper.pos"]);
            let tasks: Vec<Text> = messages(bag, "/task/instruction");
            assert_eq!(json!(tasks[0].data), episode["task"]);
            for (key, frames) in episode["cameras"].as_object().unwrap() {
                let name = key
                    .trim_start_matches("observation.images.")
                    .replace('.', "_");
                let images: Vec<CompressedImage> =
                    messages(bag, &format!("/{name}/image_raw/compressed"));
                let expected: Vec<[[f64; 3]; 4]> = serde_json::from_value(frames.clone()).unwrap();
                assert_eq!(images.len(), expected.len(), "{version} {name}");
                assert_eq!(
                    images[0].format,
                    if name == "still" { "png" } else { "jpeg" }
                );
                for (frame, (image, expected)) in images.iter().zip(&expected).enumerate() {
                    let got = quarters(&image::load_from_memory(&image.data).unwrap().into_rgb8());
                    let differences = got.as_flattened().iter().zip(expected.as_flattened());
                    let most = differences.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                    // Neighbouring frames differ by 20, frames of other episodes by 50; two encodings (JPEG, YUV conversions) by less.
                    assert!(most < 6.0, "{version} {name}, frame {frame}: {most}");
                }
            }
        }
    }
}
