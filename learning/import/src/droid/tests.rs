use std::{f64::consts::PI, fs, path::Path};

use proptest::prelude::*;

use serde_json::{Value, json};

use super::*;
use crate::{
    ImportOptions,
    episode::Trajectory,
    import_droid,
    mapping::VALUES,
    mp4_npz::tests::video,
    testing::{assert_shards_join, of_shard},
};

const FRAMES: usize = 4;

fn state(frame: usize) -> [f64; VALUES] {
    let step = frame as f64;
    // The roll passes pi after the first frame.
    let roll = if frame == 0 { 3.1 } else { step * 0.1 - PI };
    [0.4 + 0.01 * step, 0.1, 0.3, roll, 0.0, 0.0, 0.25 * step]
}

fn annotation() -> Value {
    let states: Vec<_> = (0..FRAMES).map(state).collect();
    let joints: Vec<Vec<f64>> = (0..FRAMES).map(|frame| vec![frame as f64; 8]).collect();
    let videos = (0..3).map(|n| json!({"video_path": format!("videos/val/7/{n}.mp4")}));
    json!({
        "texts": ["fold the towel"], "episode_id": 7, "success": 1, "video_length": FRAMES,
        "videos": videos.collect::<Vec<_>>(), "states": states, "joints": joints,
    })
}

fn write(root: &Path, annotation: &Value, frames: [u32; 3]) {
    fs::create_dir_all(root.join("annotation/val")).unwrap();
    fs::create_dir_all(root.join("videos/val/7")).unwrap();
    fs::write(root.join("annotation/val/7.json"), annotation.to_string()).unwrap();
    for (number, frames) in frames.into_iter().enumerate() {
        fs::write(
            root.join(format!("videos/val/7/{number}.mp4")),
            video(frames),
        )
        .unwrap();
    }
}

fn read(annotation: &Value, frames: [u32; 3]) -> Result<Episode, String> {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), annotation, frames);
    let mut found = episodes(dir.path(), 95).unwrap();
    let unread = found.next().unwrap().unwrap();
    let episode = unread.read(&ActionMapping::default());
    episode.map_err(|error| error.to_string())
}

#[test]
fn slow_frames_set_the_rate_of_the_actions() {
    let rate_of = |period_ns| {
        let trajectory = Trajectory {
            period_ns,
            ..Trajectory::default()
        };
        trajectory.space().unwrap().rate()
    };
    assert_eq!(rate_of(250_000_000), 4.0);
    assert_eq!(rate_of(200_000_000), 5.0);
    // 15 Hz: every third frame is taken.
    assert_eq!(rate_of(66_666_667), 5.0);
}

#[test]
fn annotation_with_three_videos_becomes_an_episode() {
    // A video may have frames after the last state.
    let episode = read(&annotation(), [4, 5, 4]).unwrap();
    assert_eq!(episode.recorded.period_ns, 200_000_000);
    let names: Vec<&str> = episode
        .cameras
        .iter()
        .map(|camera| camera.name.as_str())
        .collect();
    assert_eq!(names, ["exterior_1", "exterior_2", "wrist"]);
    assert!(
        episode
            .cameras
            .iter()
            .all(|camera| camera.frames.len() == FRAMES)
    );
    let [dx, dy, dz, droll, dpitch, dyaw, gripper] = episode.recorded.actions[0];
    assert!(
        (dx - 0.01).abs() < 1e-6 && dy == 0.0 && dz == 0.0,
        "{dx} {dy} {dz}"
    );
    // From 3.1 over pi by 0.1, not back by a whole turn.
    let expected = (PI - 3.1) + 0.1;
    assert!((f64::from(droll) - expected).abs() < 1e-6, "{droll}");
    assert!(dpitch.abs() < 1e-6 && dyaw.abs() < 1e-6, "{dpitch} {dyaw}");
    assert_eq!(gripper, 0.75, "a quarter closed is three quarters open");
    assert_eq!(
        episode.recorded.actions[3],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.25],
        "the last action is zero"
    );
    assert_eq!(episode.recorded.states[0][6], 1.0);
    let joints = episode.joints.unwrap();
    assert_eq!(
        (joints.names.len(), joints.names[6].as_str()),
        (7, "panda_joint7")
    );
    assert_eq!(joints.positions[2], [2.0; 7]);
    assert_eq!(
        (episode.instruction.as_deref(), episode.success),
        (Some("fold the towel"), Some(true))
    );
}

fn times(a: [[f64; 3]; 3], b: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let entry = |row: usize, column: usize| (0..3).map(|k| a[row][k] * b[k][column]).sum();
    std::array::from_fn(|row| std::array::from_fn(|column| entry(row, column)))
}

/// A rotation about axis x, y or z of the base.
fn turn(axis: usize, angle: f64) -> [[f64; 3]; 3] {
    let (s, c) = angle.sin_cos();
    match axis {
        0 => [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]],
        1 => [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
        _ => [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
    }
}

/// Roll, pitch and yaw about fixed axes.
fn angles(m: [[f64; 3]; 3]) -> [f64; 3] {
    [
        m[2][1].atan2(m[2][2]),
        -m[2][0].clamp(-1.0, 1.0).asin(),
        m[1][0].atan2(m[0][0]),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// For any orientation of the hand, also near pitch 90 degrees.
    #[test]
    fn rotations_about_base_axes_are_kept(
        axis in 0usize..3,
        step in 0.01f64..0.3,
        start in prop::array::uniform3(-1.5f64..1.5),
        steep in any::<bool>(),
    ) {
        let [roll, mut pitch, yaw] = start;
        if steep {
            pitch = 1.4;
        }
        let mut hand = times(turn(2, yaw), times(turn(1, pitch), turn(0, roll)));
        let mut states = Vec::new();
        for _ in 0..6 {
            let [roll, pitch, yaw] = angles(hand);
            states.push([0.3, 0.1, 0.3, roll, pitch, yaw, 0.2]);
            hand = times(turn(axis, step), hand);
        }
        let recorded = states::of_states(&states, &ActionMapping::default(), 0.2);
        for action in &recorded.actions[..5] {
            for (index, value) in action[3..6].iter().enumerate() {
                let expected = if index == axis { step } else { 0.0 };
                prop_assert!((f64::from(*value) - expected).abs() < 1e-5, "{action:?}");
            }
        }
    }
}

#[test]
fn episode_with_a_jump_is_skipped_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let (src, out) = (dir.path().join("src"), dir.path().join("out"));
    write(&src, &annotation(), [4; 3]);
    let mut jump = annotation();
    jump["states"][2][0] = json!(1.0);
    let folder = src.join("annotation/val");
    fs::write(folder.join("8.json"), jump.to_string()).unwrap();
    fs::write(folder.join("9.json"), annotation().to_string()).unwrap();
    let imported = import_droid(&src, &out, &ImportOptions::default()).unwrap();
    let bags = ["episode_000000", "episode_000002"].map(|bag| out.join(bag));
    assert_eq!(imported.bags, bags);
    let [reason] = &imported.skipped[..] else {
        panic!("{:?}", imported.skipped)
    };
    assert!(
        reason.contains("8.json: dx: measured") && reason.contains("at most 0.5 m"),
        "{reason}"
    );
    let remedy = "repair the states, or remove the episode";
    assert!(
        reason.contains(remedy) && !reason.contains("-scale"),
        "{reason}"
    );
    assert_eq!(
        fs::read_dir(&out).unwrap().count(),
        2,
        "no other files remain"
    );
}

#[test]
fn joints_are_taken_at_the_frames() {
    for rows in [10, 11, 12] {
        let mut annotation = annotation();
        annotation.as_object_mut().unwrap().remove("joints");
        let recorded: Vec<_> = (0..rows).map(|row| [f64::from(row); 7]).collect();
        annotation["observation.state.joint_position"] = json!(recorded);
        let joints = read(&annotation, [4; 3]).unwrap().joints.unwrap();
        let first: Vec<f64> = joints.positions.iter().map(|row| row[0]).collect();
        assert_eq!(first, [0.0, 3.0, 6.0, 9.0], "of {rows} rows");
    }
}

#[test]
fn inconsistent_annotations_are_named() {
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut annotation = annotation();
        change(&mut annotation);
        read(&annotation, [4; 3]).unwrap_err()
    };
    for (error, part) in [
        (
            changed(&|a| a["video_length"] = json!(9)),
            "7.json: states: expected 9 rows",
        ),
        (
            changed(&|a| a["states"][2] = json!([1.0])),
            "7.json: states, row 2: expected 7 values, got 1",
        ),
        (
            changed(&|a| a["joints"][1] = json!([1.0])),
            "7.json: joints, row 1: expected 7 joints",
        ),
        (
            changed(&|a| a["joints"] = json!([])),
            "7.json: joints: expected rows of 4 frames, got 0",
        ),
        (
            changed(&|a| a["success"] = json!(2)),
            "7.json: success: expected 0 or 1",
        ),
        (
            changed(&|a| a["videos"] = json!([])),
            "7.json: videos: expected 3, got 0",
        ),
        (
            changed(&|a| a["videos"][0]["video_path"] = json!("../secret.mp4")),
            "7.json: videos: expected a path inside",
        ),
        (
            changed(&|a| drop(a.as_object_mut().unwrap().remove("states"))),
            "missing field `states`",
        ),
        (
            changed(&|a| a["videos"][0]["video_path"] = json!("videos/val/7/9.mp4")),
            "9.mp4",
        ),
        (
            read(&annotation(), [4, 3, 4]).unwrap_err(),
            "1.mp4: expected 4 frames, one per state, got 3",
        ),
    ] {
        assert!(error.contains(part), "{part:?} in {error:?}");
    }
}

#[test]
fn shards_import_the_same_as_one_run() {
    let dir = tempfile::tempdir().unwrap();
    let (src, out) = (dir.path().join("src"), dir.path().join("out"));
    write(&src, &annotation(), [4; 3]);
    let file = |name: &str| src.join("annotation/val").join(name);
    for name in ["8.json", "9.json"] {
        let mut other = annotation();
        other["texts"] = json!([name]);
        fs::write(file(name), other.to_string()).unwrap();
    }
    assert_shards_join(3, |out, options| import_droid(&src, out, options));

    // A faulty episode of one shard does not affect the other.
    fs::write(file("8.json"), "").unwrap();
    let import = |index| import_droid(&src, &out, &of_shard(index, 2));
    assert_eq!(import(0).unwrap().bags.len(), 2);
    let error = import(1).unwrap_err().to_string();
    assert!(error.contains("8.json"), "{error}");
}

#[test]
fn nested_folders_are_found_in_order() {
    let dir = tempfile::tempdir().unwrap();
    for root in ["b", "a"] {
        let splits = dir.path().join(root).join("annotation/val");
        fs::create_dir_all(&splits).unwrap();
        for name in ["10.json", "9.json", "notes.txt"] {
            fs::write(splits.join(name), "").unwrap();
        }
    }
    let found = source::find(dir.path()).unwrap();
    let names: Vec<_> = found
        .iter()
        .map(|located| {
            located
                .annotation
                .strip_prefix(dir.path())
                .unwrap()
                .to_str()
                .unwrap()
        })
        .collect();
    assert_eq!(
        names,
        [
            "a/annotation/val/9.json",
            "a/annotation/val/10.json",
            "b/annotation/val/9.json",
            "b/annotation/val/10.json"
        ]
    );
    let error = source::find(&dir.path().join("a/annotation"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("has no episodes: expected DROID's"),
        "{error}"
    );
}
