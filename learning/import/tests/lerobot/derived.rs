//! Action spaces that are derived from data sets.

use std::{fs, path::Path};

use tempfile::TempDir;
use wm_bag::BagReader;
use wm_import::lerobot::{ACTION_SPACE_FILE, ExportOptions, ImportOptions, export, import};
use wm_motion::actions::{ActionSpace, Kind};

use super::made::Episode;

/// A data set of four episodes: velocities of two joints at 5 Hz, faster in each episode, and a gripper.
fn dataset(scratch: &Path) {
    let names = r#"{"name": "arm", "rate": 5, "dimensions": [
        {"name": "shoulder_vel", "unit": "rad/s", "kind": "joint_velocity"},
        {"name": "elbow_vel", "unit": "rad/s", "kind": "joint_velocity"},
        {"name": "gripper", "unit": "1", "kind": "gripper_binary"}]}"#;
    let names: ActionSpace = serde_json::from_str(names).unwrap();
    let bags: Vec<_> = (0..4)
        .map(|number| {
            let speed = 0.1 + number as f32 * 0.1;
            let of = |frame: usize, axis: usize| {
                let turns = [1.0, -0.5, 0.0, 0.7, -1.0];
                speed * turns[(frame / (3 + axis)) % 5]
            };
            let actions =
                (0..40).map(|frame| vec![of(frame, 0), of(frame, 1), f32::from(frame % 20 < 10)]);
            let mut episode = Episode::of(actions.collect(), "wave", true);
            let mut joints = vec![0.4, -0.2];
            for (frame, at) in episode.joints.iter_mut().enumerate() {
                at.clone_from(&joints);
                for (axis, joint) in joints.iter_mut().enumerate() {
                    *joint += of(frame, axis) / 5.0;
                }
            }
            let bag = scratch.join(format!("bag_{number}"));
            episode.write_with(&bag, Some(&names));
            bag
        })
        .collect();
    export(&bags, &scratch.join("dataset"), &ExportOptions::default()).unwrap();
}

fn space(bag: &Path) -> ActionSpace {
    let reader = BagReader::open(bag).unwrap();
    let note = reader.note(ActionSpace::NOTE);
    ActionSpace::of_note(Some(note.unwrap())).unwrap()
}

#[test]
fn derived_space_is_kept_by_all_bags_subsets_and_shards() {
    let scratch = TempDir::new().unwrap();
    dataset(scratch.path());
    let at = |name: &str| scratch.path().join(name);
    let whole = import(&at("dataset"), &at("whole"), &ImportOptions::default()).unwrap();
    let derived = space(&whole.bags[0]);
    let kinds: Vec<Kind> = derived.dimensions().iter().map(|d| d.kind).collect();
    let velocity = Kind::JointVelocity;
    assert_eq!(kinds, [velocity, velocity, Kind::GripperBinary]);
    assert_eq!(derived.rate(), 5.0);
    // The fastest episode has 0.4 rad/s.
    let scale = derived.dimensions()[0].scale;
    assert!((2.4..2.6).contains(&scale), "{scale}");
    let table = whole.ranges.unwrap();
    for part in [
        "shoulder_vel  joint_velocity",
        "rad/s",
        "the change of shoulder per second",
    ] {
        assert!(table.contains(part), "{table}");
    }
    let text = fs::read_to_string(at("whole").join(ACTION_SPACE_FILE)).unwrap();
    assert_eq!(serde_json::from_str::<ActionSpace>(&text).unwrap(), derived);
    let options = |options: ImportOptions| import(&at("dataset"), &at("parts"), &options).unwrap();
    let parts = [
        options(ImportOptions {
            episodes: Some(0..=0),
            ..ImportOptions::default()
        }),
        options(ImportOptions {
            shard: "1/3".parse().unwrap(),
            ..ImportOptions::default()
        }),
    ];
    for part in parts {
        assert_eq!(space(&part.bags[0]), derived);
    }
    let parts = at("parts").join(ACTION_SPACE_FILE);
    assert_eq!(fs::read_to_string(parts).unwrap(), text);
}

#[test]
fn edited_space_is_used_and_never_overwritten() {
    let scratch = TempDir::new().unwrap();
    dataset(scratch.path());
    let at = |name: &str| scratch.path().join(name);
    fs::create_dir(at("out")).unwrap();
    let file = at("out").join(ACTION_SPACE_FILE);
    fs::write(&file, "mine").unwrap();
    let imported = import(&at("dataset"), &at("out"), &ImportOptions::default()).unwrap();
    assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
    let notes: Vec<String> = imported.notes.lines().collect();
    assert!(
        notes.iter().any(|note| note.contains("stays as it is")),
        "{notes:?}"
    );

    let mut edited = serde_json::to_value(space(&imported.bags[0])).unwrap();
    edited["dimensions"][0]["scale"] = 9.0.into();
    let edited: ActionSpace = serde_json::from_value(edited).unwrap();
    let options = ImportOptions {
        action_space: Some(edited.clone()),
        ..ImportOptions::default()
    };
    let again = import(&at("dataset"), &at("again"), &options).unwrap();
    assert_eq!(space(&again.bags[0]), edited);
    assert!(!at("again").join(ACTION_SPACE_FILE).exists());
}

#[test]
fn more_values_than_an_action_may_have_give_no_space() {
    let scratch = TempDir::new().unwrap();
    let actions = (0..6).map(|frame| vec![frame as f32; 33]).collect();
    let bag = scratch.path().join("bag");
    Episode::of(actions, "wave", true).write(&bag);
    let dataset = scratch.path().join("dataset");
    export(&[bag], &dataset, &ExportOptions::default()).unwrap();
    let out = scratch.path().join("out");
    let imported = import(&dataset, &out, &ImportOptions::default()).unwrap();
    let reader = BagReader::open(&imported.bags[0]).unwrap();
    assert_eq!(reader.note(ActionSpace::NOTE), None);
    let notes: Vec<String> = imported.notes.lines().collect();
    let named = notes
        .iter()
        .any(|note| note.contains("33 values") && note.contains("at most 32"));
    assert!(named, "{notes:?}");
    assert!(!out.join(ACTION_SPACE_FILE).exists());
}
