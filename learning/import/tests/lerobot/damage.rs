use std::{fs, path::Path};

use serde_json::{Value, json};
use tempfile::TempDir;
use wm_import::lerobot::{ExportOptions, ImportOptions, export, import};

use super::made::Episode;

const DATA: &str = "data/chunk-000/file-000.parquet";
const VIDEO: &str = "videos/observation.images.front/chunk-000/file-000.mp4";

fn dataset(scratch: &Path) {
    Episode::made(4, 0.0).write(&scratch.join("bag"));
    export(
        &[scratch.join("bag")],
        &scratch.join("dataset"),
        &ExportOptions::default(),
    )
    .unwrap();
}

fn import_error(scratch: &Path) -> String {
    let out = TempDir::new().unwrap();
    let result = import(
        &scratch.join("dataset"),
        out.path(),
        &ImportOptions::default(),
    );
    let left = fs::read_dir(out.path()).unwrap();
    let left: Vec<_> = left.map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.is_empty(), "bad input left {left:?}: {result:?}");
    result.unwrap_err().to_string()
}

/// Rows have their episode's number, so a wrong file name loses nothing.
#[test]
fn rows_in_unnamed_files_are_found() {
    let scratch = TempDir::new().unwrap();
    dataset(scratch.path());
    let path = scratch.path().join("dataset/meta/info.json");
    let mut info: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    info["data_path"] = json!("data/{file_index}");
    fs::write(&path, info.to_string()).unwrap();
    let out = TempDir::new().unwrap();
    let dataset = scratch.path().join("dataset");
    let imported = import(&dataset, out.path(), &ImportOptions::default()).unwrap();
    assert_eq!(imported.bags.len(), 1);
    let notes = format!("{:?}", imported.notes);
    assert!(notes.contains("another data file"), "{notes}");
}

#[test]
fn invalid_metadata_is_named() {
    let scratch = TempDir::new().unwrap();
    dataset(scratch.path());
    let path = scratch.path().join("dataset/meta/info.json");
    let good: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut info = good.clone();
        change(&mut info);
        fs::write(&path, info.to_string()).unwrap();
        import_error(scratch.path())
    };
    let column = json!({"dtype": "float32", "shape": [1], "names": null});
    let image = json!({"dtype": "image", "shape": [1, 1, 3], "names": null});
    for (error, parts) in [
        (
            changed(&|i| i["features"]["observation.images.x"] = image.clone()),
            [DATA, "expected a column \"observation.images.x\""],
        ),
        (
            changed(&|i| i["features"]["observation.state"] = column.clone()),
            [DATA, "row 0: observation.state: expected 1 values, got 10"],
        ),
        (
            changed(&|i| i["features"]["action"]["shape"] = json!([8])),
            [DATA, "row 0: action: expected 8 values, got 7"],
        ),
        (
            changed(&|i| i["features"]["action"]["shape"] = json!([u32::MAX, u32::MAX])),
            ["info.json", "features, action"],
        ),
        (
            changed(&|i| i["fps"] = json!(7)),
            [DATA, "timestamp: expected 0.1429 s from row to row"],
        ),
        (
            changed(&|i| i["fps"] = json!(0)),
            ["info.json", "fps: expected"],
        ),
        (
            changed(&|i| i["codebase_version"] = json!("v1.6")),
            ["info.json", "codebase_version: expected v2.x or v3.x"],
        ),
        (
            changed(&|i| i["data_path"] = json!("../{file_index}")),
            ["info.json", "expected a path inside the data set"],
        ),
        (
            changed(&|i| drop(i.as_object_mut().unwrap().remove("features"))),
            ["info.json", "missing field `features`"],
        ),
    ] {
        assert!(
            parts.iter().all(|part| error.contains(part)),
            "{parts:?} in {error:?}"
        );
    }
}

#[test]
fn truncated_files_are_named() {
    let scratch = TempDir::new().unwrap();
    dataset(scratch.path());
    for (file, part) in [
        (DATA, "parquet"),
        (VIDEO, "front"),
        ("meta/tasks.parquet", "parquet"),
        ("meta/episodes/chunk-000/file-000.parquet", "parquet"),
    ] {
        let path = scratch.path().join("dataset").join(file);
        let whole = fs::read(&path).unwrap();
        for end in (0..whole.len()).step_by((whole.len() / 16).max(1)) {
            fs::write(&path, &whole[..end]).unwrap();
            let error = import_error(scratch.path());
            assert!(
                error.contains(file) && error.contains(part),
                "{file} cut at {end}: {error}"
            );
        }
        fs::write(&path, whole).unwrap();
    }
    // A video with fewer frames than rows.
    let other = scratch.path().join("shorter");
    fs::create_dir(&other).unwrap();
    Episode::made(3, 0.0).write(&other.join("bag"));
    export(
        &[other.join("bag")],
        &other.join("dataset"),
        &ExportOptions::default(),
    )
    .unwrap();
    fs::copy(
        other.join("dataset").join(VIDEO),
        scratch.path().join("dataset").join(VIDEO),
    )
    .unwrap();
    let error = import_error(scratch.path());
    assert!(
        error.contains(VIDEO)
            && error.contains("expected 4 frames, one for each row of episode 0, got 3"),
        "{error}"
    );
}

#[test]
fn bad_episode_is_skipped_and_others_imported() {
    let scratch = TempDir::new().unwrap();
    let bags: Vec<_> = (0..3)
        .map(|n| scratch.path().join(format!("bag_{n}")))
        .collect();
    for (number, bag) in bags.iter().enumerate() {
        Episode::made(4, number as f32).write(bag);
    }
    let dataset = scratch.path().join("dataset");
    // A video per episode.
    let options = ExportOptions {
        video_file_bytes: 1,
        ..ExportOptions::default()
    };
    export(&bags, &dataset, &options).unwrap();
    let video = dataset.join("videos/observation.images.front/chunk-000/file-001.mp4");
    let whole = fs::read(&video).unwrap();
    fs::write(&video, &whole[..whole.len() / 2]).unwrap();
    let out = scratch.path().join("out");
    let imported = import(&dataset, &out, &ImportOptions::default()).unwrap();
    assert_eq!(
        imported.bags,
        ["episode_000000", "episode_000002"].map(|bag| out.join(bag))
    );
    let [reason] = &imported.skipped[..] else {
        panic!("{:?}", imported.skipped)
    };
    assert!(
        reason.starts_with("episode 1: ") && reason.contains("file-001.mp4"),
        "{reason}"
    );
    assert_eq!(fs::read_dir(&out).unwrap().count(), 2, "no half a bag");
    assert_eq!(Episode::read(&imported.bags[1]), Episode::made(4, 2.0));
    let ranges = imported.ranges.unwrap();
    assert!(
        ranges.starts_with("actions of 3 episodes at 5 Hz: dx "),
        "{ranges}"
    );
}

#[test]
fn contradicting_actions_name_column_range_and_option() {
    let scratch = TempDir::new().unwrap();
    let bag = scratch.path().join("bag");
    let grippers = [-1.0, 0.0, 1.0, 1.0];
    let action = |gripper| vec![0.003, 0.0, 0.0, 0.0, 0.0, 0.0, gripper];
    Episode::of(grippers.map(action).to_vec(), "grip", true).write(&bag);
    let dataset = scratch.path().join("dataset");
    export(&[bag], &dataset, &ExportOptions::default()).unwrap();
    let mut options = ImportOptions::default();
    let error = import(&dataset, &scratch.path().join("a"), &options).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("gripper: measured -1 to 1") && error.contains("--gripper-range -1:1"),
        "{error}"
    );
    options.actions.gripper = Some("-1:1".parse().unwrap());
    let imported = import(&dataset, &scratch.path().join("b"), &options).unwrap();
    let openings = Episode::read(&imported.bags[0])
        .actions
        .into_iter()
        .map(|action| action[6]);
    assert_eq!(openings.collect::<Vec<_>>(), [0.0, 0.5, 1.0, 1.0]);
}
