//! Real data sets have no audit faults. They are in the folder of the environment variable WM_SHARED_DATA (`bridge_v2/`,
//! `bridge_rlds/`, `droid/`, `g1_bottle/`), outside the repository.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use tempfile::TempDir;
use wm_audit::{Level, Topics, audit_bag};
use wm_bag::BagReader;

use crate::folder::shared;

/// Imports a data set with the program, and audits each bag.
fn expect_no_fault(format: &str, source: &Path, options: &[&str]) {
    let out = TempDir::new().unwrap();
    let mut import = Command::new(env!("CARGO_BIN_EXE_wm-datasets"));
    import
        .args(["import", format])
        .arg(source)
        .arg(out.path())
        .args(options);
    let output = import.output().unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let entries = std::fs::read_dir(out.path()).unwrap();
    let mut bags: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    bags.retain(|path| path.join("metadata.yaml").is_file());
    bags.sort();
    assert!(!bags.is_empty());
    for bag in bags {
        let audit = audit_bag(&BagReader::open(&bag).unwrap(), &Topics::default(), || ());
        assert!(
            audit.worst() < Level::Warning,
            "{}:\n{audit}",
            bag.display()
        );
    }
}

#[test]
fn bridge_has_no_fault() {
    for name in ["bridge_v2", "bridge_rlds"] {
        if let Some(source) = shared(name) {
            expect_no_fault("bridge", &source, &[]);
        }
    }
}

#[test]
fn droid_has_no_fault() {
    if let Some(source) = shared("droid") {
        expect_no_fault("droid", &source, &[]);
    }
}

#[test]
fn humanoid_with_targets_has_no_fault() {
    let Some(source) = shared("g1_bottle") else {
        return;
    };
    let text = std::fs::read(source.join("meta/info.json")).unwrap();
    let info: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let names = info.pointer("/features/action/names").unwrap();
    let names = names.as_array().unwrap();
    // Its authors wrote a nested list.
    let names = names
        .first()
        .and_then(|inner| inner.as_array())
        .unwrap_or(names);
    let dimension = |name: &serde_json::Value| serde_json::json!({"name": name, "unit": "rad", "kind": "joint_position", "scale": 0.5, "clip": 2.0});
    let space = serde_json::json!({
        "name": "unitree_g1",
        "rate": info["fps"].as_f64().unwrap(),
        "dimensions": names.iter().map(dimension).collect::<Vec<_>>(),
    });
    let dir = TempDir::new().unwrap();
    let file = dir.path().join("space.json");
    std::fs::write(&file, space.to_string()).unwrap();
    let options = [
        "--episodes",
        "0..9",
        "--action-space",
        file.to_str().unwrap(),
    ];
    expect_no_fault("lerobot", &source, &options);
}
