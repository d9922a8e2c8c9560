use std::{fs, path::Path};

use serde_json::{Value, json};
use tempfile::TempDir;
use wm_lerobot::{ExportOptions, ImportOptions, export, import};

use crate::made::Episode;

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
    assert_eq!(
        fs::read_dir(out.path()).unwrap().count(),
        0,
        "bad input leaves no half a bag"
    );
    result.unwrap_err().to_string()
}

#[test]
fn metadata_that_do_not_fit_are_named() {
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
            [DATA, "row 1: timestamp: expected 0.142"],
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
        (
            changed(&|i| i["data_path"] = json!("data/{file_index}")),
            ["data/0", "No such file"],
        ),
    ] {
        assert!(
            parts.iter().all(|part| error.contains(part)),
            "{parts:?} in {error:?}"
        );
    }
}

#[test]
fn files_that_are_cut_are_named() {
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
    // A video of fewer frames than the table has rows.
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
        error.contains(VIDEO) && error.contains("expected frame 3 of 4 at 0.6"),
        "{error}"
    );
}
