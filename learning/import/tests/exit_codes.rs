//! Output and exit codes of `wm-datasets`.

use std::{fs, path::Path, process::Command};

use tempfile::TempDir;
use wm_bag::{BagWriter, QosProfile, WriterOptions};
use wm_msgs::{
    sensor_msgs::Image,
    std_msgs::{Header, String as Text},
    wm_msgs::Action,
};

/// Exit code, standard output and standard error.
fn run(args: &[&str]) -> (i32, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_wm-datasets"))
        .args(args)
        .output()
        .unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (
        output.status.code().unwrap(),
        text(output.stdout),
        text(output.stderr),
    )
}

/// Writes a bag with four frames; the last has this gripper value.
fn bag(path: &Path, gripper: f32) {
    bag_at(path, gripper, [0, 200, 400, 600]);
}

/// As [`bag`], with frames at these times \[ms\].
fn bag_at(path: &Path, gripper: f32, times_ms: [u64; 4]) {
    let mut writer = BagWriter::create(path, WriterOptions::default()).unwrap();
    writer
        .add_topic::<Text>("/task/instruction", QosProfile::latched())
        .unwrap();
    for (frame, time_ms) in times_ms.into_iter().enumerate() {
        let stamp_ns = 1_700_000_000_000_000_000 + time_ms * 1_000_000;
        let header = Header {
            stamp: wm_msgs::builtin_interfaces::Time::from_nanos(stamp_ns as i64),
            frame_id: "base_link".into(),
        };
        let image = Image {
            header: header.clone(),
            height: 32,
            width: 32,
            encoding: "rgb8".into(),
            step: 96,
            data: [frame as u8 * 40, 90, 20].repeat(32 * 32),
            ..Image::default()
        };
        writer.write("/camera/image_raw", &image, stamp_ns).unwrap();
        let last = if frame == 3 { gripper } else { 1.0 };
        let values = vec![0.01, 0.0, 0.0, 0.0, 0.0, 0.1, last];
        writer
            .write("/wm/action", &Action { header, values }, stamp_ns)
            .unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn exit_code_shows_whether_all_episodes_are_imported() {
    let scratch = TempDir::new().unwrap();
    let at = |name: &str| scratch.path().join(name).to_str().unwrap().to_owned();
    let bags = ["a", "b"].map(|name| scratch.path().join(name));
    for path in &bags {
        bag(path, 0.0);
    }
    let dataset = at("dataset");
    let (code, _, errors) = run(&["export", "lerobot", &dataset, &at("a"), &at("b")]);
    assert_eq!(code, 0, "{errors}");

    let (code, printed, errors) = run(&["import", "lerobot", &dataset, &at("whole")]);
    assert_eq!(code, 0, "{errors}");
    assert_eq!(printed.lines().count(), 2);
    assert!(
        errors.contains("actions of 2 episodes at 5 Hz: dx 0.01 to 0.01 m"),
        "{errors}"
    );

    // The second episode has a row without a frame.
    let meta = Path::new(&dataset).join("meta/info.json");
    let info = fs::read_to_string(&meta).unwrap();
    let wrong = info.replace(
        "chunk_index:03d}/file-{file_index:03d}.mp4",
        "chunk_index:03d}/none.mp4",
    );
    assert_ne!(info, wrong);
    fs::write(&meta, wrong).unwrap();
    let (code, printed, errors) = run(&["import", "lerobot", &dataset, &at("none")]);
    assert_eq!((code, printed.as_str()), (1, ""), "{errors}");
    assert!(
        errors.contains("none of 2 episodes can be imported"),
        "{errors}"
    );
    assert!(errors.contains("none.mp4"), "{errors}");
    fs::write(&meta, info).unwrap();

    for wrong in ["1", "1:1", "a:b"] {
        let (code, _, errors) = run(&[
            "import",
            "lerobot",
            &dataset,
            &at("x"),
            "--gripper-range",
            wrong,
        ]);
        assert_eq!(code, 2, "{errors}");
        assert!(errors.contains("CLOSED:OPEN"), "{errors}");
    }
}

#[test]
fn export_without_a_part_of_a_bag_ends_with_3() {
    let scratch = TempDir::new().unwrap();
    let at = |name: &str| scratch.path().join(name).to_str().unwrap().to_owned();
    bag_at(&scratch.path().join("a"), 0.0, [0, 200, 60_000, 120_000]);
    bag_at(&scratch.path().join("b"), 0.0, [0, 200, 60_000, 60_200]);
    let (code, printed, errors) = run(&["export", "lerobot", &at("one"), &at("a")]);
    assert_eq!(code, 3, "{errors}");
    assert!(printed.contains("1 episodes, 2 frames"), "{printed}");
    assert!(errors.contains("a: split into 3 recordings"), "{errors}");
    let skipped = "skipped: ";
    assert_eq!(errors.matches(skipped).count(), 2, "{errors}");
    assert!(
        errors.contains("a: 1 action(s) and 1 picture(s)"),
        "{errors}"
    );
    let (code, printed, errors) = run(&["export", "lerobot", &at("two"), &at("b")]);
    assert_eq!(code, 0, "{errors}");
    assert!(printed.contains("2 episodes, 4 frames"), "{printed}");
}

#[test]
fn skipped_episodes_are_named_and_end_with_3() {
    let scratch = TempDir::new().unwrap();
    let at = |name: &str| scratch.path().join(name);
    let bags = ["a", "b", "c"].map(at);
    for path in &bags {
        bag(path, 0.0);
    }
    // A video per episode; the second one is truncated.
    let options = wm_import::lerobot::ExportOptions {
        video_file_bytes: 1,
        ..wm_import::lerobot::ExportOptions::default()
    };
    let dataset = at("dataset");
    wm_import::lerobot::export(&bags, &dataset, &options).unwrap();
    let video = dataset.join("videos/observation.images.camera/chunk-000/file-001.mp4");
    let whole = fs::read(&video).unwrap();
    fs::write(&video, &whole[..whole.len() / 2]).unwrap();
    let out = at("out");
    let (dataset, out) = (dataset.to_str().unwrap(), out.to_str().unwrap());
    let (code, printed, errors) = run(&["import", "lerobot", dataset, out]);
    assert_eq!(code, 3, "{errors}");
    assert_eq!(
        printed,
        format!("{out}/episode_000000\n{out}/episode_000002\n")
    );
    assert!(
        errors.contains("skipped: episode 1: ") && errors.contains("file-001.mp4"),
        "{errors}"
    );
    assert!(
        errors.contains("2 episodes imported, 1 skipped"),
        "{errors}"
    );
}
