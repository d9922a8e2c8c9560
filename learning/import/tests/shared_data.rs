//! Real episodes of Bridge V2, DROID and two LeRobot data sets, from the directory that the environment variable
//! WM_SHARED_DATA names (with `bridge_v2/`, `bridge_rlds/`, `droid/`, `cr5_banana/` and `g1_bottle/` in it). They are not
//! part of the repository.

use image::{ImageFormat, RgbImage};
use tempfile::TempDir;
use wm_bag::{BagMessage, BagReader};
use wm_import::{ImportOptions, import_bridge, import_droid, lerobot};
use wm_motion::actions::{ActionSpace, Dimension, Kind};
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::PoseStamped,
    sensor_msgs::{CompressedImage, JointState},
    std_msgs::{Bool, Float32, String as Text},
    wm_msgs::Action,
};

use crate::folder::shared;

fn of_topic(reader: &BagReader, topic: &str) -> Vec<BagMessage> {
    reader
        .messages()
        .only_topics([topic])
        .map(Result::unwrap)
        .collect()
}

fn decoded(image: &CompressedImage) -> RgbImage {
    image::load_from_memory_with_format(&image.data, ImageFormat::Jpeg)
        .unwrap()
        .into_rgb8()
}

#[test]
fn bridge_videos_become_bags() {
    let Some(src) = shared("bridge_v2") else {
        return;
    };
    let out = TempDir::new().unwrap();
    let bags = import_bridge(&src, out.path(), &ImportOptions::default())
        .unwrap()
        .bags;
    let mut lengths = Vec::new();
    for bag in &bags {
        let reader = BagReader::open(bag).unwrap();
        let actions: Vec<Action> = of_topic(&reader, "/wm/action")
            .iter()
            .map(|message| message.decode().unwrap())
            .collect();
        let frames = of_topic(&reader, "/camera/image_raw/compressed");
        assert_eq!(frames.len(), actions.len());
        lengths.push(frames.len());
        for (step, (frame, action)) in frames.iter().zip(&actions).enumerate() {
            let frame: CompressedImage = frame.decode().unwrap();
            let stamp = Time::from_nanos(1_700_000_000_000_000_000 + step as i64 * 200_000_000);
            assert_eq!((frame.header.stamp, action.header.stamp), (stamp, stamp));
            assert_eq!(decoded(&frame).dimensions(), (256, 256));
            let [dx, dy, dz, droll, dpitch, dyaw, gripper] = action.values[..] else {
                panic!("seven values")
            };
            // A WidowX moves less than 5 cm and 0.35 rad in 0.2 s.
            assert!(
                [dx, dy, dz].iter().all(|value| value.abs() < 0.05),
                "{action:?}"
            );
            assert!(
                [droll, dpitch, dyaw].iter().all(|value| value.abs() < 0.35),
                "{action:?}"
            );
            assert!(gripper == 0.0 || gripper == 1.0, "{action:?}");
        }
        assert!(
            actions[0].values[6] == 1.0,
            "every episode starts with an open gripper"
        );
    }
    assert_eq!(lengths, [40, 41, 32, 23, 31, 41, 27]);
}

#[test]
fn bridge_rlds_becomes_bags() {
    let Some(src) = shared("bridge_rlds") else {
        return;
    };
    let out = TempDir::new().unwrap();
    let bags = import_bridge(&src, out.path(), &ImportOptions::default())
        .unwrap()
        .bags;
    assert_eq!(bags.len(), 25);
    let mut covariance = 0.0;
    for bag in &bags {
        let reader = BagReader::open(bag).unwrap();
        let topics: Vec<(&str, u64)> = reader
            .topics()
            .iter()
            .map(|topic| (&*topic.name, topic.message_count))
            .collect();
        let cameras = ["/camera/", "/camera_1/", "/camera_2/"]
            .map(|camera| format!("{camera}image_raw/compressed"));
        for camera in &cameras {
            assert!(topics.contains(&(camera, 10)), "{topics:?}");
            let first: CompressedImage = of_topic(&reader, camera)[0].decode().unwrap();
            assert_eq!(decoded(&first).dimensions(), (64, 64));
        }
        assert_eq!(
            topics.len(),
            3 + 4,
            "the fourth camera is missing: {topics:?}"
        );
        let instruction: Text = of_topic(&reader, "/task/instruction")[0].decode().unwrap();
        assert!(instruction.data.contains(' '), "{instruction:?}");
        let poses: Vec<PoseStamped> = of_topic(&reader, "/arm/end_effector_pose")
            .iter()
            .map(|message| message.decode().unwrap())
            .collect();
        let actions: Vec<Action> = of_topic(&reader, "/wm/action")
            .iter()
            .map(|message| message.decode().unwrap())
            .collect();
        for (pair, action) in poses.windows(2).zip(&actions) {
            let (before, after) = (pair[0].pose.position, pair[1].pose.position);
            covariance += (after.x - before.x) * f64::from(action.values[0])
                + (after.y - before.y) * f64::from(action.values[1])
                + (after.z - before.z) * f64::from(action.values[2]);
        }
        let gripper: Float32 = of_topic(&reader, "/arm/gripper")[0].decode().unwrap();
        assert!((-0.1..1.1).contains(&gripper.data), "{gripper:?}");
    }
    assert!(covariance > 0.0, "the pose follows the actions");
}

#[test]
fn droid_becomes_bags() {
    let Some(src) = shared("droid") else {
        return;
    };
    let out = TempDir::new().unwrap();
    let bags = import_droid(&src, out.path(), &ImportOptions::default())
        .unwrap()
        .bags;
    let mut lengths = Vec::new();
    let (mut successes, mut instructions) = (0, 0);
    for bag in &bags {
        let reader = BagReader::open(bag).unwrap();
        let count = |topic: &str| reader.topic(topic).map_or(0, |topic| topic.message_count);
        let frames = count("/wm/action");
        lengths.push(frames);
        for camera in ["exterior_1", "exterior_2", "wrist"] {
            let topic = format!("/{camera}/image_raw/compressed");
            assert_eq!(count(&topic), frames, "{topic}");
            let last: CompressedImage = of_topic(&reader, &topic).last().unwrap().decode().unwrap();
            assert_eq!(decoded(&last).dimensions(), (320, 192));
            assert_eq!(last.header.frame_id, format!("{camera}_optical_frame"));
        }
        for topic in ["/arm/end_effector_pose", "/arm/gripper", "/joint_states"] {
            assert_eq!(count(topic), frames, "{topic}");
        }
        let actions: Vec<Action> = of_topic(&reader, "/wm/action")
            .iter()
            .map(|message| message.decode().unwrap())
            .collect();
        let poses: Vec<PoseStamped> = of_topic(&reader, "/arm/end_effector_pose")
            .iter()
            .map(|message| message.decode().unwrap())
            .collect();
        // The sum of the actions is the motion from the first pose to the last.
        let (first, last) = (
            &poses[0].pose.position,
            &poses[poses.len() - 1].pose.position,
        );
        let sum = |axis: usize| {
            actions
                .iter()
                .map(|action| f64::from(action.values[axis]))
                .sum::<f64>()
        };
        for (axis, way) in [last.x - first.x, last.y - first.y, last.z - first.z]
            .into_iter()
            .enumerate()
        {
            assert!(
                (sum(axis) - way).abs() < 1e-4,
                "axis {axis}: {} and {way}",
                sum(axis)
            );
        }
        // A Franka turns less than 1.5 rad in a frame, and its joints stay within their limits (2.9 rad; the sixth 3.75).
        assert!(
            actions
                .iter()
                .all(|action| action.values[3..6].iter().all(|turn| turn.abs() < 1.5))
        );
        for message in of_topic(&reader, "/joint_states") {
            let state: JointState = message.decode().unwrap();
            assert_eq!((state.name.len(), state.position.len()), (7, 7));
            assert!(
                state.position.iter().all(|angle| angle.abs() < 3.8),
                "{state:?}"
            );
        }
        let success: Bool = of_topic(&reader, "/task/success")[0].decode().unwrap();
        successes += usize::from(success.data);
        instructions += usize::from(reader.topic("/task/instruction").is_some());
        let period = (reader.end_ns() - reader.start_ns()) / (frames - 1);
        assert!(period == 200_000_000 || period == 250_000_000, "{period}");
    }
    assert_eq!(
        lengths,
        [
            88, 93, 205, 146, 132, 41, 85, 47, 56, 89, 137, 80, 124, 62, 39, 33, 121, 41, 72
        ],
        "eight episodes of one folder, seven and four of the splits of the other"
    );
    assert_eq!((successes, instructions), (12, 14));
}

/// The action space that the import of one episode derives.
fn derived(name: &str) -> Option<Vec<Dimension>> {
    let src = shared(name)?;
    let out = TempDir::new().unwrap();
    let options = lerobot::ImportOptions {
        episodes: Some(0..=0),
        ..lerobot::ImportOptions::default()
    };
    let imported = lerobot::import(&src, out.path(), &options).unwrap();
    let reader = BagReader::open(&imported.bags[0]).unwrap();
    let note = reader.note(ActionSpace::NOTE);
    let space = ActionSpace::of_note(Some(note.unwrap())).unwrap();
    Some(space.dimensions().to_vec())
}

/// A Dobot CR5: six joint velocities and a gripper, of which the fifth joint hardly moves.
#[test]
fn joint_velocities_of_a_real_arm_are_derived() {
    let Some(dimensions) = derived("cr5_banana") else {
        return;
    };
    let (gripper, joints) = dimensions.split_last().unwrap();
    assert_eq!((joints.len(), gripper.kind), (6, Kind::GripperBinary));
    for joint in joints {
        assert_eq!((joint.kind, &*joint.unit), (Kind::JointVelocity, "rad/s"));
        assert!((1.0..20.0).contains(&joint.scale), "{joint:?}");
    }
}

/// A Unitree G1: targets of 14 arm joints and 12 fingers, one arm nearly still.
#[test]
fn joint_targets_of_a_real_humanoid_are_derived() {
    let Some(dimensions) = derived("g1_bottle") else {
        return;
    };
    assert_eq!(dimensions.len(), 26);
    for (index, joint) in dimensions.iter().enumerate() {
        let expected = match index < 14 {
            true => (Kind::JointPosition, "rad"),
            false => (Kind::Position, "1"),
        };
        assert_eq!((joint.kind, &*joint.unit), expected, "{joint:?}");
        assert!((1.0..20.0).contains(&joint.scale), "{joint:?}");
    }
}
