//! Interoperability with independent readers and writers: rosbags, mcap and mcap-ros2-support from PyPI, in the virtual
//! environment that `tests/setup_ros2` makes.

use std::{
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};
use tempfile::TempDir;
use wm_bag::{
    BagReader, BagWriter, Compression, CutEnd, CutStart, Durability, QosProfile, StoragePreset,
    TopicFilter, WriterOptions, cut, recover,
};
use wm_msgs::{
    builtin_interfaces::Time,
    diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue},
    geometry_msgs::PoseStamped,
    sensor_msgs::{CompressedImage, Image},
    std_msgs::{Bool, Float32, Header, String as Text},
    wm_msgs::{Action, ActionChunk, Latent},
};

const START_NS: u64 = 1_700_000_000_000_000_000;

/// Runs a Python program of `tests/interop`; `None` (with a plain message) if its libraries are not installed.
fn peer(script: &str, arg: &Path) -> Option<Value> {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let python = root.join(".venv/tools/bin/python");
    if !python.is_file() {
        eprintln!(
            "skipped: no rosbags and mcap under .venv/tools; run tests/setup_ros2 (tests/run does)"
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
    assert!(
        output.status.success(),
        "{script} {}: {}",
        arg.display(),
        String::from_utf8_lossy(&output.stderr)
    );
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

/// The contents of a bag, in the form that the Python programs print.
fn contents(bag: &Path) -> Value {
    let rows = BagReader::open(bag).unwrap().messages().map(|message| {
        let message = message.unwrap();
        let digest: String = Sha256::digest(&message.data)
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        json!([
            &*message.topic,
            &*message.type_name,
            message.log_time_ns,
            digest
        ])
    });
    Value::Array(rows.collect())
}

/// A bag with every kind of field: texts, byte and number sequences, nested types, odd alignments.
fn write_bag(dir: &Path, compression: Compression) {
    let options = WriterOptions {
        compression,
        chunk_size: 4096,
        ..WriterOptions::default()
    };
    write_bag_with(dir, options);
}

fn write_bag_with(dir: &Path, options: WriterOptions) {
    let mut writer = BagWriter::create(dir, options).unwrap();
    writer
        .add_topic::<Text>("/task/instruction", QosProfile::latched())
        .unwrap();
    writer
        .add_topic::<CompressedImage>("/camera/image_raw/compressed", QosProfile::sensor_data())
        .unwrap();
    writer
        .add_topic::<Bool>("/task/success", QosProfile::latched())
        .unwrap();
    writer
        .write(
            "/task/instruction",
            &Text {
                data: "grüße the ☕".into(),
            },
            START_NS,
        )
        .unwrap();
    for step in 0..30u64 {
        let log_time_ns = START_NS + step * 200_000_000;
        let stamp = Time::from_nanos(log_time_ns as i64);
        let header = Header {
            stamp,
            frame_id: "base_link".repeat(step as usize % 3),
        };
        let bytes: Vec<u8> = (0..step * 37).map(|number| (number * step) as u8).collect();
        let image = Image {
            header: header.clone(),
            height: 1,
            width: bytes.len() as u32,
            encoding: "mono8".into(),
            step: bytes.len() as u32,
            data: bytes.clone(),
            ..Image::default()
        };
        let compressed = CompressedImage {
            header: header.clone(),
            format: "jpeg".into(),
            data: bytes.clone(),
        };
        let action = Action {
            header: header.clone(),
            values: vec![step as f32 * 0.1; 7],
        };
        let latent = Latent {
            header: header.clone(),
            height: 2,
            width: 3,
            channels: 4,
            data: bytes,
            ..Latent::default()
        };
        let chunk = ActionChunk {
            header: header.clone(),
            actions: vec![action.clone(); step as usize % 4],
            ..ActionChunk::default()
        };
        let pose = PoseStamped {
            header: header.clone(),
            ..PoseStamped::default()
        };
        let status = DiagnosticStatus {
            name: "encoder".into(),
            values: vec![KeyValue {
                key: "rate".into(),
                value: step.to_string(),
            }],
            ..DiagnosticStatus::default()
        };
        let diagnostics = DiagnosticArray {
            header,
            status: vec![status; 2],
        };
        writer
            .write("/camera/image_raw", &image, log_time_ns)
            .unwrap();
        writer
            .write("/camera/image_raw/compressed", &compressed, log_time_ns + 1)
            .unwrap();
        writer
            .write("/wm/action", &action, log_time_ns + 2)
            .unwrap();
        writer
            .write("/wm/latent", &latent, log_time_ns + 3)
            .unwrap();
        writer
            .write("/wm/action_chunk", &chunk, log_time_ns + 4)
            .unwrap();
        writer
            .write("/arm/end_effector_pose", &pose, log_time_ns + 5)
            .unwrap();
        writer
            .write(
                "/arm/gripper",
                &Float32 { data: step as f32 },
                log_time_ns + 6,
            )
            .unwrap();
        writer
            .write("/diagnostics", &diagnostics, log_time_ns + 7)
            .unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn other_readers_read_our_bags() {
    let scratch = TempDir::new().unwrap();
    for (name, compression) in [
        ("plain", Compression::None),
        ("lz4", Compression::Lz4),
        ("zstd", Compression::Zstd),
    ] {
        let bag = scratch.path().join(name);
        write_bag(&bag, compression);
        let Some(seen) = peer("bags_read.py", &bag) else {
            return;
        };
        let written = contents(&bag);
        assert_eq!(written.as_array().unwrap().len(), 1 + 30 * 8);
        assert_eq!(seen["rosbags"], written, "{name}");
        assert_eq!(seen["mcap"], written, "{name}");
        assert_eq!(
            seen["qos"]["/task/instruction"],
            json!([["reliable", "transient_local", 1]])
        );
        assert_eq!(
            seen["qos"]["/camera/image_raw/compressed"],
            json!([["best_effort", "volatile", 5]])
        );
        assert_eq!(
            seen["qos"]["/wm/action"],
            json!([["reliable", "volatile", 10]])
        );
        assert_eq!(seen["counts"]["/wm/latent"], 30);
        assert_eq!(
            seen["counts"]["/task/success"], 0,
            "a topic without messages is listed"
        );
    }
}

#[test]
fn other_readers_read_split_bags_and_presets() {
    let scratch = TempDir::new().unwrap();
    let plain = WriterOptions::default;
    let split = |compression| WriterOptions {
        compression,
        chunk_size: 4096,
        max_file_duration: Some(Duration::from_secs(1)),
        ..plain()
    };
    let preset = |preset| WriterOptions { preset, ..plain() };
    for (name, options, files) in [
        ("split_plain", split(Compression::None), 6),
        ("split_lz4", split(Compression::Lz4), 6),
        ("split_zstd", split(Compression::Zstd), 6),
        ("fastwrite", preset(StoragePreset::FastWrite), 1),
        ("zstd_fast", preset(StoragePreset::ZstdFast), 1),
        ("zstd_small", preset(StoragePreset::ZstdSmall), 1),
    ] {
        let bag = scratch.path().join(name);
        write_bag_with(&bag, options);
        let Some(seen) = peer("bags_read.py", &bag) else {
            return;
        };
        let reader = BagReader::open(&bag).unwrap();
        assert_eq!(reader.summary().files.len(), files, "{name}");
        let written = contents(&bag);
        assert_eq!(written.as_array().unwrap().len(), 1 + 30 * 8);
        // Other readers see the latched instruction at the start of each file.
        let once = |seen: &Value| -> Value {
            let mut came = std::collections::HashSet::new();
            let rows = seen.as_array().unwrap().iter();
            let rows =
                rows.filter(|row| row[0] != "/task/instruction" || came.insert(row[3].clone()));
            rows.cloned().collect()
        };
        let repeated = seen["mcap"].as_array().unwrap().len() - (1 + 30 * 8);
        assert_eq!(repeated, files - 1, "{name}");
        assert_eq!(once(&seen["rosbags"]), written, "{name}");
        assert_eq!(once(&seen["mcap"]), written, "{name}");
        assert_eq!(seen["counts"]["/wm/latent"], 30, "{name}");
    }
}

#[test]
fn other_readers_read_recovered_and_cut_bags() {
    let scratch = TempDir::new().unwrap();
    let whole = scratch.path().join("whole");
    write_bag(&whole, Compression::Zstd);
    let file = whole.join("whole_0.mcap");
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() / 3]).unwrap();
    let (recovered, part) = (
        scratch.path().join("recovered"),
        scratch.path().join("part"),
    );
    let recovery = recover(&file, &recovered).unwrap();
    assert_eq!(recovery.without_end, [file]);
    let start = CutStart::After(Duration::from_millis(1100));
    cut(
        &recovered,
        &part,
        start,
        CutEnd::End,
        &TopicFilter::default(),
    )
    .unwrap();
    for bag in [recovered, part] {
        let Some(seen) = peer("bags_read.py", &bag) else {
            return;
        };
        let written = contents(&bag);
        assert!(written.as_array().unwrap().len() > 20);
        assert_eq!(seen["rosbags"], written, "{}", bag.display());
        assert_eq!(seen["mcap"], written, "{}", bag.display());
        assert_eq!(
            seen["qos"]["/task/instruction"],
            json!([["reliable", "transient_local", 1]])
        );
    }
}

#[test]
fn bags_of_rosbags_are_read() {
    let scratch = TempDir::new().unwrap();
    let Some(written) = peer("bags_write.py", scratch.path()) else {
        return;
    };
    let bag = |name: &str| -> PathBuf { scratch.path().join(name) };
    for name in ["v8", "v9", "v8_storage", "v9_storage"] {
        assert_eq!(contents(&bag(name)), written[name], "{name}");
        let reader = BagReader::open(bag(name)).unwrap();
        assert!(
            reader.warnings().is_empty(),
            "{name}: {:?}",
            reader.warnings()
        );
        assert_eq!(
            reader
                .topic("/task/instruction")
                .unwrap()
                .qos()
                .unwrap()
                .durability,
            Durability::TransientLocal
        );
        let first = reader.messages().next().unwrap().unwrap();
        assert_eq!(first.decode::<Text>().unwrap().data, "pick up the ☕");
    }
    for name in ["v8_message", "v9_message", "v8_file", "v9_file"] {
        assert_eq!(contents(&bag(name)), written[name], "{name}");
    }
}

#[test]
fn copy_of_a_foreign_bag_keeps_its_bytes() {
    let scratch = TempDir::new().unwrap();
    let Some(written) = peer("bags_write.py", scratch.path()) else {
        return;
    };
    let source = BagReader::open(scratch.path().join("v9")).unwrap();
    let copy = scratch.path().join("copy");
    let mut writer = BagWriter::create(&copy, WriterOptions::default()).unwrap();
    for topic in source.topics() {
        writer
            .add_topic_raw(
                &topic.name,
                &topic.type_name,
                &topic.schema,
                &topic.qos_yaml,
            )
            .unwrap();
    }
    for message in source.messages() {
        let message = message.unwrap();
        let schema = &source.topic(&message.topic).unwrap().schema;
        writer
            .write_raw(
                &message.topic,
                &message.type_name,
                schema,
                message.log_time_ns,
                &message.data,
            )
            .unwrap();
    }
    writer.finish().unwrap();
    let Some(seen) = peer("bags_read.py", &copy) else {
        return;
    };
    assert_eq!(seen["rosbags"], written["v9"]);
    assert_eq!(seen["mcap"], written["v9"]);
}
