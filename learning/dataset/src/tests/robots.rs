//! Several kinds of cameras, actions and robots.

use wm_motion::actions::{ActionSpace, Dimension, Kind};

use super::{
    super::{Data, DataOptions, Dataset},
    outcome::Outcome,
};
use crate::testing::{CAMERA, Recorder};

fn two_joints() -> ActionSpace {
    let dimension = |name: &str, kind| Dimension {
        name: name.into(),
        unit: "rad".into(),
        kind,
        offset: 0.0,
        scale: 1.0,
        clip: 10.0,
    };
    let dimensions = vec![
        dimension("elbow", Kind::JointDelta),
        dimension("wrist", Kind::JointPosition),
    ];
    ActionSpace::new("two_joints".into(), 5.0, dimensions).unwrap()
}

#[test]
fn two_cameras_are_side_by_side_and_unpaired_frames_counted() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::new(&bag);
    for frame in 0..10 {
        recorder.frame("/front/image_raw/compressed", frame * 200, frame as u8);
        // The other camera is 40 ms late, and misses the last frame.
        if frame < 9 {
            recorder.frame(
                "/wrist/image_raw/compressed",
                frame * 200 + 40,
                100 + frame as u8,
            );
        }
        recorder.action(frame * 200, 0.01);
    }
    recorder.finish();
    let options = DataOptions {
        cameras: vec![
            "/front/image_raw".into(),
            "/wrist/image_raw/compressed".into(),
        ],
        ..DataOptions::default()
    };
    let outcome = Outcome::of(&bag, options).unwrap();
    let training = &outcome.data.training;
    assert_eq!((training.size(), training.views()), ((16, 16), 2));
    assert_eq!(outcome.lengths(), [9]);
    for frame in 0..9 {
        let left: Vec<u8> = [frame as u8, 20, 30].repeat(8);
        let right: Vec<u8> = [100 + frame as u8, 20, 30].repeat(8);
        let rows = [left, right].concat().repeat(16);
        assert_eq!(training.frame(frame), Some(&*rows), "{frame}");
    }
    let left = outcome.left_out();
    assert!(
        left.contains("1 frame: no frame of /wrist/image_raw/compressed within 0.10 s"),
        "{left}"
    );

    let several = Outcome::of(&bag, DataOptions::default()).err().unwrap();
    let text = several.to_string();
    assert!(
        text.contains("--camera: /front/image_raw, /wrist/image_raw"),
        "{text}"
    );
    let options = DataOptions {
        cameras: vec!["/back/image_raw".into()],
        ..DataOptions::default()
    };
    let text = Outcome::of(&bag, options).err().unwrap().to_string();
    assert!(text.contains("no camera /back/image_raw"), "{text}");
    let options = DataOptions {
        cameras: vec!["/front/image_raw".into()],
        action_topic: Some("/arm/action".into()),
        ..DataOptions::default()
    };
    let text = Outcome::of(&bag, options).err().unwrap().to_string();
    assert!(
        text.contains("expected messages on /arm/action; --action-topic could be /wm/action"),
        "{text}"
    );
}

#[test]
fn single_camera_is_found_and_different_ones_rejected() {
    let dir = tempfile::tempdir().unwrap();
    for (name, camera) in [("a", "/front"), ("b", "/wrist")] {
        let mut recorder = Recorder::new(&dir.path().join("bags").join(name));
        for frame in 0..4 {
            let topic = format!("{camera}/image_raw/compressed");
            recorder.frame(&topic, frame * 200, 1);
            recorder.action(frame * 200, 0.01);
        }
        recorder.finish();
    }
    let one = Outcome::of(&dir.path().join("bags/a"), DataOptions::default()).unwrap();
    assert_eq!(one.manifest.cameras, ["/front/image_raw"]);
    let both = Outcome::of(&dir.path().join("bags"), DataOptions::default());
    let text = both.err().unwrap().to_string();
    assert!(
        text.contains("cameras differ: it has /wrist/image_raw") && text.contains("has /front"),
        "{text}"
    );
}

#[test]
fn undeclared_other_robot_is_rejected() {
    let dir = tempfile::tempdir().unwrap();
    for (name, values) in [("a", 7), ("b", 6)] {
        let mut recorder = Recorder::new(&dir.path().join(name));
        for frame in 0..4 {
            recorder.frame(CAMERA, frame * 200, 1);
            recorder.values(frame * 200, vec![0.0; values]);
        }
        recorder.finish();
    }
    let error = Outcome::of(dir.path(), DataOptions::default())
        .err()
        .unwrap();
    let text = error.to_string();
    assert!(
        text.contains("/b") && text.contains("6 values; expected 7 of bridge_v2: dx"),
        "{text}"
    );
}

#[test]
fn joint_states_become_actions_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let space = dir.path().join("space.yaml");
    std::fs::write(&space, serde_yaml_ng::to_string(&two_joints()).unwrap()).unwrap();
    let options = DataOptions {
        action_topic: Some("/joint_states".into()),
        action_space: Some(space),
        ..DataOptions::default()
    };
    for has_positions in [true, false] {
        let bag = dir.path().join(format!("run_{has_positions}"));
        let mut recorder = Recorder::new(&bag);
        for tick in 0..100 {
            let ms = tick * 20;
            if tick % 10 == 0 {
                recorder.frame(CAMERA, ms, 1);
            }
            // 0.5 rad/s.
            let elbow = ms as f64 * 0.5e-3;
            let names = ["wrist", "finger", "elbow"];
            let positions = vec![0.25, 9.0, elbow];
            if has_positions {
                recorder.joints(ms, &names, positions, Vec::new());
            } else {
                recorder.joints(ms, &["wrist", "elbow"], Vec::new(), vec![0.0, 0.5]);
            }
        }
        recorder.finish();
        let outcome = Outcome::of(&bag, options.clone());
        if !has_positions {
            // A position joint needs a position.
            let text = outcome.err().unwrap().to_string();
            assert!(text.contains("no actions"), "{text}");
            continue;
        }
        let outcome = outcome.unwrap();
        assert_eq!(outcome.lengths(), [10]);
        for action in &outcome.episodes()[0].actions {
            assert!((action[0] - 0.1).abs() < 1e-5, "{action:?}");
            assert_eq!(action[1], 0.25);
        }
    }
    let bag = dir.path().join("other");
    let mut recorder = Recorder::new(&bag);
    recorder.run(0..4);
    recorder.joints(0, &["shoulder"], vec![0.0], Vec::new());
    recorder.finish();
    let text = Outcome::of(&bag, options).err().unwrap().to_string();
    assert!(text.contains("no \"elbow\" among [\"shoulder\"]"), "{text}");
}

/// An arm at 50 Hz and a wrist at 20 Hz publish their joints on one topic.
#[test]
fn joints_of_two_publishers_are_merged() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::with_space(&bag, &two_joints());
    for ms in (0..2000).step_by(10) {
        if ms % 200 == 0 {
            recorder.frame(CAMERA, ms, 1);
        }
        if ms % 50 == 0 {
            recorder.joints(ms, &["wrist"], vec![0.25], Vec::new());
        }
        if ms % 20 == 0 {
            let elbow = ms as f64 * 0.5e-3;
            recorder.joints(ms, &["elbow", "shoulder"], vec![elbow, 0.0], Vec::new());
        }
    }
    recorder.finish();
    let options = DataOptions {
        action_topic: Some("/joint_states".into()),
        ..DataOptions::default()
    };
    let outcome = Outcome::of(&bag, options).unwrap();
    assert_eq!(outcome.lengths(), [10]);
    for action in &outcome.episodes()[0].actions {
        assert!((action[0] - 0.1).abs() < 1e-5, "{action:?}");
        assert_eq!(action[1], 0.25);
    }
}

/// A model knows no durations: an interval 1.5 periods long has 1.5 times the motion, as with deltas.
#[test]
fn velocity_over_a_long_interval_is_more_motion() {
    let dir = tempfile::tempdir().unwrap();
    let elbow = Dimension {
        kind: Kind::JointVelocity,
        unit: "rad/s".into(),
        ..two_joints().dimensions()[0].clone()
    };
    let space = ActionSpace::new("elbow".into(), 5.0, vec![elbow]).unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::with_space(&bag, &space);
    for ms in [0, 200, 500, 700, 850, 1050] {
        recorder.frame(CAMERA, ms, 1);
        recorder.values(ms, vec![0.5]);
    }
    recorder.finish();
    let outcome = Outcome::of(&bag, DataOptions::default()).unwrap();
    let actions: Vec<f32> = outcome.episodes()[0].actions.iter().map(|a| a[0]).collect();
    let expected = [0.5, 0.75, 0.5, 0.375, 0.5, 0.5];
    assert_eq!(actions.len(), expected.len());
    for (found, expected) in actions.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-6, "{actions:?}");
    }
}

#[test]
fn velocities_move_joints_without_positions() {
    let dir = tempfile::tempdir().unwrap();
    let elbow = two_joints().dimensions()[0].clone();
    let space = ActionSpace::new("elbow".into(), 5.0, vec![elbow]).unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::with_space(&bag, &space);
    for tick in 0..100 {
        if tick % 10 == 0 {
            recorder.frame(CAMERA, tick * 20, 1);
        }
        recorder.joints(tick * 20, &["elbow"], Vec::new(), vec![0.5]);
    }
    recorder.finish();
    let options = DataOptions {
        action_topic: Some("/joint_states".into()),
        ..DataOptions::default()
    };
    let outcome = Outcome::of(&bag, options).unwrap();
    for action in &outcome.episodes()[0].actions {
        assert!((action[0] - 0.1).abs() < 1e-5, "{action:?}");
    }
}

/// Actions in the bag are targets; the user asks for the motion of its joints.
#[test]
fn joints_are_read_as_asked_whatever_the_bag_declares() {
    let dir = tempfile::tempdir().unwrap();
    let dimension = |kind| Dimension {
        kind,
        ..two_joints().dimensions()[0].clone()
    };
    let elbow = |kind| ActionSpace::new("elbow".into(), 5.0, vec![dimension(kind)]).unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::with_space(&bag, &elbow(Kind::JointPosition));
    for frame in 0..8 {
        let ms = frame * 200;
        recorder.frame(CAMERA, ms, 1);
        recorder.values(ms, vec![1.0]);
        recorder.joints(ms, &["elbow"], vec![0.1 * frame as f64], Vec::new());
    }
    recorder.finish();
    let space = dir.path().join("space.json");
    std::fs::write(&space, elbow(Kind::JointDelta).to_note().unwrap()).unwrap();
    let options = DataOptions {
        action_topic: Some("/joint_states".into()),
        action_space: Some(space),
        ..DataOptions::default()
    };
    let outcome = Outcome::of(&bag, options).unwrap();
    for action in &outcome.episodes()[0].actions {
        assert!((action[0] - 0.1).abs() < 1e-5, "{action:?}");
    }
}

#[test]
fn action_space_of_another_robot_is_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::with_space(&bag, &ActionSpace::bridge());
    recorder.run(0..4);
    recorder.finish();
    let space = dir.path().join("space.json");
    std::fs::write(&space, two_joints().to_note().unwrap()).unwrap();
    let options = DataOptions {
        action_space: Some(space),
        ..DataOptions::default()
    };
    let text = Outcome::of(&bag, options).err().unwrap().to_string();
    assert!(
        text.contains("--action-space takes two_joints: elbow") && text.contains("bridge_v2: dx"),
        "{text}"
    );
}

/// An undecodable picture counts as missing: the episode is cut there.
#[test]
fn broken_picture_is_excluded_and_counted() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::new(&bag);
    for frame in 0..12 {
        if frame == 6 {
            recorder.picture(CAMERA, frame * 200, vec![1, 2, 3]);
        } else {
            recorder.frame(CAMERA, frame * 200, frame as u8);
        }
        recorder.action(frame * 200, 0.01);
    }
    recorder.finish();
    let outcome = Outcome::of(&bag, DataOptions::default()).unwrap();
    assert_eq!(outcome.lengths(), [6, 5]);
    assert_eq!(outcome.reds(), [0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11]);
    let left = outcome.left_out();
    let named = format!("1 picture: cannot be decoded: {CAMERA}: ");
    assert!(left.contains(&named), "{left}");
    let reason = left.split(&named).nth(1).unwrap();
    assert!(reason.len() > 5, "{left}");
}

#[test]
fn bag_with_only_implausible_actions_is_excluded() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::new(&bag);
    for frame in 0..6 {
        recorder.frame(CAMERA, frame * 200, frame as u8);
        recorder.action(frame * 200, 50.0);
    }
    recorder.finish();
    let text = Outcome::of(&bag, DataOptions::default()).err().unwrap();
    let text = text.to_string();
    for named in ["no actions", "6 actions: ", "dx", "--action-space"] {
        assert!(text.contains(named), "{named}: {text}");
    }
}

#[test]
fn bags_are_found_and_folders_without_any_named() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("recordings");
    for name in ["monday/a", "tuesday/morning/b"] {
        let mut recorder = Recorder::new(&root.join(name));
        recorder.run(0..4);
        recorder.finish();
    }
    // A single file, with another name and other contents.
    let mut recorder = Recorder::new(&dir.path().join("c"));
    recorder.run(0..5);
    recorder.finish();
    std::fs::create_dir_all(root.join("wednesday")).unwrap();
    std::fs::rename(dir.path().join("c/c_0.mcap"), root.join("wednesday/c.mcap")).unwrap();
    std::fs::create_dir_all(root.join("notes/old")).unwrap();
    // A bag without actions, and a damaged one.
    let mut recorder = Recorder::new(&root.join("blind"));
    recorder.action(0, 0.0);
    recorder.finish();
    std::fs::write(root.join("wednesday/empty.mcap"), b"").unwrap();
    let outcome = Outcome::of(&root, DataOptions::default()).unwrap();
    let names: Vec<_> = outcome.episodes().iter().map(|e| e.name.clone()).collect();
    assert_eq!(names, ["a", "b", "c"]);
    let left = outcome.left_out();
    for named in [
        "notes: no bag",
        "blind: no camera",
        "empty.mcap is not a bag",
    ] {
        assert!(left.contains(named), "{named}: {left}");
    }
}

#[test]
fn held_out_bags_are_never_trained_on() {
    let dir = tempfile::tempdir().unwrap();
    for (name, frames) in [("a", 4), ("b", 5), ("c", 6)] {
        let folder = if name == "c" { "held_out" } else { "bags" };
        let mut recorder = Recorder::new(&dir.path().join(folder).join(name));
        recorder.run(0..frames);
        recorder.finish();
    }
    let cache = dir.path().join("cache");
    let paths = [dir.path().join("bags")];
    let open = |held_out: &str| {
        let options = DataOptions {
            held_out: vec![dir.path().join(held_out)],
            ..DataOptions::default()
        };
        Data::open(&paths, (16, 16), &cache, &options)
    };
    let data = open("held_out").unwrap();
    assert_eq!(data.training.frame_count(), 9);
    assert_eq!(data.validation.unwrap().frame_count(), 6);
    let error = open("bags").unwrap_err().to_string();
    assert!(error.contains("every bag is held out"), "{error}");
    let data = open("bags/b").unwrap();
    assert_eq!(data.training.frame_count(), 4, "a alone");
    assert_eq!(data.validation.unwrap().frame_count(), 5);
    std::fs::rename(dir.path().join("held_out/c"), dir.path().join("c")).unwrap();
    std::fs::create_dir(dir.path().join("held_out/b")).unwrap();
    for entry in std::fs::read_dir(dir.path().join("bags/b")).unwrap() {
        let path = entry.unwrap().path();
        let copy = dir
            .path()
            .join("held_out/b")
            .join(path.file_name().unwrap());
        std::fs::copy(&path, copy).unwrap();
    }
    let error = open("held_out").unwrap_err().to_string();
    assert!(
        error.contains("b: b is held out, but also trained on"),
        "{error}"
    );
    let all = Dataset::held_out(&paths, (16, 16), &cache, &DataOptions::default()).unwrap();
    assert_eq!(all.frame_count(), 9, "all episodes of bags");
}
