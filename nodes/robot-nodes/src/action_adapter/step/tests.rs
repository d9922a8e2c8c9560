//! Properties of the adapter.

mod joints;
mod leaps;

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::{self, Transform, TransformStamped},
    std_msgs::Header,
};

use super::*;
use crate::displacement::Displacement;
use wm_sim::message::pose as pose_message;

const MS: i64 = 1_000_000;
/// When the tests begin \[ns\].
const START: i64 = 1_700_000_000_000_000_000;

fn settings(source: MotionSource) -> Settings {
    let motions = Motions::EndEffector {
        source,
        layout: Layout::new(ActionSpace::bridge()).unwrap(),
        speeds: Speeds {
            linear: 2.0,
            angular: 4.0,
        },
    };
    settings_of(motions)
}

fn settings_of(motions: Motions) -> Settings {
    Settings {
        motions,
        base_frame: "base_link".into(),
        period: Duration::from_millis(200),
        timeout: Duration::from_millis(500),
        gripper: GripperSource::Open,
    }
}

fn adapter(source: MotionSource) -> AdapterStep {
    AdapterStep::new(settings(source))
}

fn header(ms: i64) -> Header {
    Header {
        stamp: Time::from_nanos(START + ms * MS),
        frame_id: "base_link".into(),
    }
}

/// A hand that moves on a curve and turns.
fn hand(ms: i64) -> Isometry3<f64> {
    let s = ms as f64 / 1e3;
    let turn = UnitQuaternion::from_euler_angles(0.3 * s, 2.0 + 0.2 * (2.0 * s).sin(), -0.4 * s);
    let at = Translation3::new(0.3 + 0.05 * s.sin(), 0.1 * s, 0.2 - 0.02 * s * s);
    Isometry3::from_parts(at, turn)
}

fn pose(ms: i64) -> PoseStamped {
    PoseStamped {
        header: header(ms),
        pose: pose_message(&hand(ms)),
    }
}

fn twist(ms: i64, forward: f64) -> TwistStamped {
    let mut twist = TwistStamped {
        header: header(ms),
        ..TwistStamped::default()
    };
    (twist.twist.linear.x, twist.twist.angular.z) = (forward, 1.0);
    twist
}

/// The actions, all of them good: when they began \[ms\], and their values.
fn actions(adapter: &mut AdapterStep) -> Vec<(i64, Vec<f32>)> {
    let done = adapter.take_done().into_iter();
    done.map(|done| done.map(|done| ((done.stamp_ns - START) / MS, done.values)))
        .collect::<Result<_, _>>()
        .unwrap()
}

/// What actions add up to.
fn sum(actions: &[(i64, Vec<f32>)]) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let none = (Vector3::zeros(), UnitQuaternion::identity());
    actions.iter().fold(none, |(moved, turned), (_, values)| {
        let values: Vec<f64> = values.iter().map(|value| f64::from(*value)).collect();
        let turn = UnitQuaternion::from_euler_angles(values[3], values[4], values[5]);
        (
            moved + Vector3::new(values[0], values[1], values[2]),
            turn * turned,
        )
    })
}

proptest! {
    #[test]
    fn actions_of_poses_add_up_to_the_motion(waits in prop::collection::vec(1_i64..400, 10..60)) {
        let mut adapter = adapter(MotionSource::Pose);
        let mut ms = 0;
        adapter.pose(&pose(0), 0).unwrap();
        for wait in waits {
            ms += wait;
            adapter.pose(&pose(ms), 0).unwrap();
        }
        let done = actions(&mut adapter);
        let ends: Vec<_> = done.iter().map(|(start, _)| *start).collect();
        let expected: Vec<_> = (0..ms / 200).map(|count| count * 200).collect();
        prop_assert_eq!(ends, expected);
        let (moved, turned) = sum(&done);
        // Between two poses 0.4 s apart a curve is cut.
        let end = hand(ms / 200 * 200);
        let way = end.translation.vector - hand(0).translation.vector;
        prop_assert!((moved - way).norm() < 2e-3, "{moved} for {way}");
        let turn = end.rotation * hand(0).rotation.inverse();
        prop_assert!(turned.angle_to(&turn) < 2e-2, "{}", turned.angle_to(&turn));
    }
}

#[test]
fn poses_at_both_ends_of_a_period_give_its_displacement() {
    let mut adapter = adapter(MotionSource::Pose);
    for ms in [0, 200, 400] {
        adapter.pose(&pose(ms), 0).unwrap();
    }
    let done = actions(&mut adapter);
    assert_eq!(done.len(), 2);
    let (first, second) = (hand(200), hand(400));
    let displacement = Displacement::between(&first, &second);
    let (at, turn) = (displacement.translation, displacement.rotation());
    let expected = [at.x, at.y, at.z, turn.x, turn.y, turn.z, 1.0];
    for (found, expected) in done[1].1.iter().zip(expected) {
        assert!((f64::from(*found) - expected).abs() < 1e-6, "{done:?}");
    }
}

#[test]
fn twists_are_integrated_and_hold_until_the_next_one() {
    let mut adapter = adapter(MotionSource::Twist);
    adapter.twist(&twist(0, 0.1), 0).unwrap();
    adapter.twist(&twist(50, 0.2), 0).unwrap();
    // Received late, but its stamp counts.
    adapter.twist(&twist(300, 0.0), START + 9_000 * MS).unwrap();
    let done = actions(&mut adapter);
    assert_eq!(done.len(), 1);
    let (start, values) = &done[0];
    assert_eq!(*start, 0);
    assert!(
        (values[0] - 0.035).abs() < 1e-6 && (values[5] - 0.2).abs() < 1e-6,
        "{values:?}"
    );
    adapter.twist(&twist(400, 0.0), 0).unwrap();
    let values = &actions(&mut adapter)[0].1;
    assert!((values[0] - 0.02).abs() < 1e-6, "{values:?}");
}

#[test]
fn after_the_last_twist_come_a_stop_and_then_silence() {
    let mut adapter = adapter(MotionSource::Twist);
    assert!(adapter.tick(START));
    adapter.twist(&twist(0, 0.1), 0).unwrap();
    assert!(!adapter.tick(START + 400 * MS));
    assert!(
        actions(&mut adapter).is_empty(),
        "an older one may still come"
    );
    assert!(adapter.tick(START + 9_000 * MS));
    let done = actions(&mut adapter);
    let forward: Vec<_> = done
        .iter()
        .map(|(start, values)| (*start, values[0]))
        .collect();
    // It holds for 0.5 s.
    let expected = [(0, 0.02), (200, 0.02), (400, 0.01), (600, 0.0)];
    assert_eq!(forward.len(), expected.len(), "{forward:?}");
    for (found, expected) in forward.iter().zip(expected) {
        assert!(
            found.0 == expected.0 && (found.1 - expected.1).abs() < 1e-6,
            "{forward:?}"
        );
    }
    adapter.twist(&twist(9_100, 0.1), 0).unwrap();
    adapter.twist(&twist(9_300, 0.1), 0).unwrap();
    assert_eq!(actions(&mut adapter)[0].0, 9_100);
    // A clock that is ahead has closed what comes now.
    adapter.tick(START + 9_950 * MS);
    let late = adapter.twist(&twist(9_400, 0.1), 0).unwrap_err();
    assert!(
        late.reason() == "late" && late.to_string().contains("0.050 s"),
        "{late}"
    );
}

#[test]
fn across_a_gap_there_is_no_action_and_it_is_counted() {
    let mut adapter = adapter(MotionSource::Pose);
    for ms in [0, 100, 200, 300] {
        adapter.pose(&pose(ms), 0).unwrap();
    }
    assert_eq!(actions(&mut adapter).len(), 1);
    assert!(adapter.tick(START + 900 * MS));
    let gap = adapter.pose(&pose(1_500), 0).unwrap_err();
    assert_eq!((gap.reason(), gap.count()), ("gap", 6));
    assert!(actions(&mut adapter).is_empty());
    adapter.pose(&pose(1_700), 0).unwrap();
    assert_eq!(actions(&mut adapter)[0].0, 1_500);
}

#[test]
fn stamps_that_go_back_begin_anew_and_overtaken_are_dropped() {
    for source in [MotionSource::Pose, MotionSource::Twist] {
        let mut adapter = adapter(source.clone());
        let mut take = |ms: i64| match source {
            MotionSource::Twist => adapter.twist(&twist(ms, 0.1), 0),
            _ => adapter.pose(&pose(ms), 0),
        };
        take(5_000).unwrap();
        take(5_150).unwrap();
        assert_eq!(take(5_140).unwrap_err().reason(), "older");
        assert_eq!(take(1_000).unwrap_err().reason(), "clock_jumped");
        take(1_250).unwrap();
        assert_eq!(actions(&mut adapter)[0].0, 1_000);
        adapter.forget();
        assert!(adapter.tick(START + 1_250 * MS));
    }
}

#[test]
fn what_is_no_pose_and_no_twist_is_refused_by_name() {
    let mut adapter = adapter(MotionSource::Pose);
    let mut refused = |change: &dyn Fn(&mut PoseStamped)| {
        let mut pose = pose(0);
        change(&mut pose);
        let problem = adapter.pose(&pose, 0).unwrap_err();
        (problem.reason(), problem.to_string())
    };
    for (found, reason, named) in [
        (
            refused(&|pose| pose.pose.position.y = f64::NAN),
            "not_finite",
            "ee_pose has NaN",
        ),
        (
            refused(&|pose| pose.pose.orientation.w += 0.1),
            "not_unit",
            "expected 1",
        ),
        (
            refused(&|pose| {
                pose.pose.orientation = geometry_msgs::Quaternion {
                    w: 0.0,
                    ..geometry_msgs::Quaternion::default()
                }
            }),
            "not_unit",
            "norm 0",
        ),
        (
            refused(&|pose| pose.header.frame_id = "camera".into()),
            "wrong_frame",
            "\"camera\"",
        ),
        (
            refused(&|pose| pose.header.stamp.nanosec = 2_000_000_000),
            "bad_stamp",
            "2000000000 ns",
        ),
    ] {
        assert_eq!(found.0, reason);
        assert!(found.1.contains(named), "{}", found.1);
    }
    let mut adapter = self::adapter(MotionSource::Twist);
    let refused = adapter.twist(&twist(0, f64::INFINITY), 0).unwrap_err();
    assert_eq!(refused.reason(), "not_finite");
    // None of them counts.
    adapter.twist(&twist(100, 0.1), 0).unwrap();
    adapter.twist(&twist(300, 0.1), 0).unwrap();
    assert_eq!(actions(&mut adapter)[0].0, 100);
}

#[test]
fn quaternions_within_one_percent_are_normalised() {
    let mut adapter = adapter(MotionSource::Pose);
    for (ms, norm) in [(0, 0.9985), (200, 1.009)] {
        let mut pose = pose(ms);
        let turn = &mut pose.pose.orientation;
        for value in [&mut turn.x, &mut turn.y, &mut turn.z, &mut turn.w] {
            *value *= norm;
        }
        adapter.pose(&pose, 0).unwrap();
    }
    let (_, turned) = sum(&actions(&mut adapter));
    let turn = hand(200).rotation * hand(0).rotation.inverse();
    assert!(turned.angle_to(&turn) < 1e-3);
}

#[test]
fn gripper_joints_that_were_overtaken_are_dropped() {
    let source = GripperSource::Joint {
        name: "finger".into(),
        closed: 0.0,
        open: 1.0,
    };
    let mut adapter = AdapterStep::new(Settings {
        gripper: source,
        ..settings(MotionSource::Pose)
    });
    let mut take = |ms: i64, name: &str, at: f64| {
        let joints = JointState {
            header: header(ms),
            name: vec![name.into()],
            position: vec![at],
            ..JointState::default()
        };
        let taken = adapter.joints(&joints, 0);
        taken.map_err(|problem| problem.reason())
    };
    assert_eq!(take(0, "finger", 0.2), Ok(Some(0.2)));
    // The arm is another part, in a message of its own.
    assert_eq!(take(20, "elbow", 0.9), Ok(None));
    assert_eq!(take(100, "finger", 0.4), Ok(Some(0.4)));
    assert_eq!(take(90, "finger", 0.9), Err("older"));
    assert_eq!(take(100, "finger", 0.9), Ok(Some(0.4)));
    adapter.pose(&pose(0), 0).unwrap();
    adapter.pose(&pose(200), 0).unwrap();
    assert_eq!(actions(&mut adapter)[0].1[6], 0.4);
}

#[test]
fn without_a_stamp_the_reception_counts() {
    let mut adapter = adapter(MotionSource::Twist);
    for ms in [0, 100, 200] {
        let mut twist = twist(0, 0.1);
        twist.header.stamp = Time::default();
        adapter.twist(&twist, START + ms * MS).unwrap();
    }
    assert_eq!(actions(&mut adapter)[0].0, 0);
}

#[test]
fn the_gripper_is_that_of_the_periods_end() {
    let source = GripperSource::Joint {
        name: "finger".into(),
        closed: 0.0,
        open: 0.04,
    };
    let mut adapter = AdapterStep::new(Settings {
        gripper: source,
        ..settings(MotionSource::Pose)
    });
    let joints = |ms: i64, name: &str, at: f64| JointState {
        header: header(ms),
        name: vec!["elbow".into(), name.into()],
        position: vec![1.0, at],
        ..JointState::default()
    };
    adapter.pose(&pose(0), 0).unwrap();
    adapter.pose(&pose(200), 0).unwrap();
    let none = adapter.take_done();
    assert_eq!(none, [Err(Problem::NoGripper)]);
    // Another robot's joints.
    assert_eq!(adapter.joints(&joints(250, "thumb", 0.0), 0), Ok(None));
    assert_eq!(
        adapter.joints(&joints(300, "finger", 0.05), 0),
        Ok(Some(1.0))
    );
    assert_eq!(
        adapter.joints(&joints(350, "finger", 0.01), 0),
        Ok(Some(0.25))
    );
    assert_eq!(
        adapter.joints(&joints(450, "finger", 0.0), 0),
        Ok(Some(0.0))
    );
    let refused = adapter
        .joints(&joints(460, "finger", f64::NAN), 0)
        .unwrap_err();
    assert_eq!(refused.reason(), "not_finite");
    adapter.pose(&pose(500), 0).unwrap();
    assert_eq!(actions(&mut adapter)[0].1[6], 0.25);
    assert_eq!(
        adapter.gripper(f64::NAN, 0).unwrap_err().reason(),
        "not_finite"
    );
}

fn frame(ms: i64, parent: &str, child: &str, at: &Isometry3<f64>) -> TransformStamped {
    let pose = pose_message(at);
    TransformStamped {
        header: Header {
            frame_id: parent.into(),
            ..header(ms)
        },
        child_frame_id: child.into(),
        transform: Transform {
            translation: geometry_msgs::Vector3 {
                x: pose.position.x,
                y: pose.position.y,
                z: pose.position.z,
            },
            rotation: pose.orientation,
        },
    }
}

fn frames() -> AdapterStep {
    adapter(MotionSource::Frames {
        base: "base_link".into(),
        tool: "tool".into(),
    })
}

#[test]
fn transforms_are_composed_at_a_time_when_all_are_known() {
    let mut adapter = frames();
    let mount = Isometry3::translation(0.0, 0.0, 1.0) * Isometry3::rotation(Vector3::x());
    let tip = Isometry3::translation(0.1, 0.0, 0.0);
    let tell = |adapter: &mut AdapterStep, is_static, all: Vec<TransformStamped>| {
        let message = TFMessage { transforms: all };
        assert_eq!(adapter.transforms(&message, is_static), []);
    };
    // The base and the arm both hang on a table.
    tell(
        &mut adapter,
        true,
        vec![
            frame(0, "table", "base_link", &mount),
            frame(0, "/flange", "tool", &tip),
        ],
    );
    let missing = adapter.follow().unwrap_err().to_string();
    assert!(
        missing.contains("the root of \"tool\" is \"flange\""),
        "{missing}"
    );
    let column = |ms: i64| Isometry3::translation(0.0, 0.0, ms as f64 / 1e4);
    tell(
        &mut adapter,
        false,
        vec![frame(0, "table", "column", &column(0))],
    );
    tell(
        &mut adapter,
        false,
        vec![frame(30, "column", "flange", &hand(30))],
    );
    // The column is not known at 30 ms, nor the flange at 0.
    assert!(matches!(adapter.follow(), Err(LookupError::Time(_))));
    let mut expected = Vec::new();
    for ms in (50..1000).step_by(50) {
        tell(
            &mut adapter,
            false,
            vec![frame(ms, "table", "column", &column(ms))],
        );
        tell(
            &mut adapter,
            false,
            vec![frame(ms + 30, "column", "flange", &hand(ms + 30))],
        );
        let Some((stamp_ns, pose)) = adapter.follow().unwrap() else {
            panic!("nothing new at {ms} ms")
        };
        // The flange is known at 30 ms more and 20 ms less.
        assert_eq!(stamp_ns, START + ms * MS);
        let exact = mount.inverse() * column(ms) * hand(ms) * tip;
        assert!((pose.translation.vector - exact.translation.vector).norm() < 1e-4);
        assert!(pose.rotation.angle_to(&exact.rotation) < 1e-3);
        expected.push(exact);
        assert_eq!(adapter.follow(), Ok(None));
    }
    let done = actions(&mut adapter);
    assert_eq!(done[0].0, 50);
    let (moved, turned) = sum(&done);
    let end = &expected[done.len() * 4];
    let way = end.translation.vector - expected[0].translation.vector;
    assert!((moved - way).norm() < 1e-3, "{moved} for {way}");
    let turn = end.rotation * expected[0].rotation.inverse();
    assert!(turned.angle_to(&turn) < 5e-3);
}

#[test]
fn frames_that_lead_round_nowhere_or_never_move_are_named() {
    let mut adapter = frames();
    let one = Isometry3::identity();
    let ring = TFMessage {
        transforms: vec![
            frame(0, "tool", "hand", &one),
            frame(0, "hand", "tool", &one),
        ],
    };
    adapter.transforms(&ring, false);
    assert_eq!(adapter.follow(), Err(LookupError::Ring("tool".into())));
    let mut adapter = frames();
    let fixed = TFMessage {
        transforms: vec![frame(0, "base_link", "tool", &one)],
    };
    adapter.transforms(&fixed, true);
    assert!(matches!(adapter.follow(), Err(LookupError::Static { .. })));
    let mut bad = frame(0, "base_link", "tool", &one);
    bad.transform.rotation.w = 0.5;
    let mut good = frame(10, "base_link", "tool", &one);
    good.transform.translation.x = 0.2;
    let problems = adapter.transforms(
        &TFMessage {
            transforms: vec![bad, good],
        },
        false,
    );
    assert_eq!(
        problems.iter().map(Problem::reason).collect::<Vec<_>>(),
        ["not_unit"]
    );
    assert_eq!(adapter.follow().unwrap().unwrap().0, START + 10 * MS);
    // The clock was set: what moved is forgotten.
    adapter.forget();
    assert!(adapter.follow().is_err());
}
