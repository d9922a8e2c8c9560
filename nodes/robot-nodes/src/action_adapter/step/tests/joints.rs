//! Actions of joints.

use wm_motion::actions::{Dimension, Kind};

use super::*;

fn space(kinds: &[(&str, Kind)]) -> ActionSpace {
    let dimension = |(name, kind): &(&str, Kind)| Dimension {
        name: (*name).into(),
        unit: "rad".into(),
        kind: *kind,
        offset: 0.0,
        scale: 1.0,
        clip: 1.0,
    };
    let dimensions = kinds.iter().map(dimension).collect();
    ActionSpace::new("arm".into(), 5.0, dimensions).unwrap()
}

fn adapter(kinds: &[(&str, Kind)], gripper: GripperSource) -> AdapterStep {
    let has_gripper = gripper != GripperSource::Open;
    let space = JointSpace::new(space(kinds), has_gripper).unwrap();
    AdapterStep::new(Settings {
        gripper,
        ..settings_of(Motions::Joints(space))
    })
}

fn state(ms: i64, joints: &[(&str, f64)]) -> JointState {
    JointState {
        header: header(ms),
        name: joints.iter().map(|(name, _)| (*name).into()).collect(),
        position: joints.iter().map(|(_, position)| *position).collect(),
        ..JointState::default()
    }
}

/// Where the elbow is \[rad\].
fn elbow(ms: i64) -> f64 {
    (ms as f64 / 500.0).sin()
}

proptest! {
    #[test]
    fn deltas_and_velocities_give_the_whole_motion_at_any_rate(steps in prop::collection::vec(2_i64..300, 4..60)) {
        let mut adapter = adapter(
            &[("elbow", Kind::JointDelta), ("wrist", Kind::JointVelocity), ("hand", Kind::JointPosition)],
            GripperSource::Open,
        );
        let (mut ms, mut expected_ms) = (0, 0);
        let mut whole = [0.0; 2];
        let mut told: Vec<(i64, f64)> = Vec::new();
        for step in std::iter::once(0).chain(steps) {
            ms += step;
            let at = elbow(ms);
            told.push((ms, at));
            let state = state(ms, &[("hand", at), ("wrist", at), ("elbow", at)]);
            prop_assert_eq!(adapter.joints(&state, 0), Ok(None));
            for (began_ms, values) in actions(&mut adapter) {
                prop_assert_eq!(began_ms, expected_ms);
                expected_ms += 200;
                whole[0] += values[0];
                whole[1] += values[1] * 0.2;
            }
            prop_assert!(ms - expected_ms < 200, "{} {}", ms, expected_ms);
            // Where the joint is at the end of the last period, if it moves evenly from one message to the next.
            let next = told.partition_point(|(told_ms, _)| *told_ms <= expected_ms);
            let (from_ms, from) = told[next - 1];
            let expected = told.get(next).map_or(from, |(to_ms, to)| {
                from + (to - from) * (expected_ms - from_ms) as f64 / (to_ms - from_ms) as f64
            });
            for whole in whole {
                prop_assert!((f64::from(whole) - expected).abs() < 1e-4, "{} {}", whole, expected);
            }
        }
    }
}

#[test]
fn periods_that_end_with_messages_are_exact() {
    let kinds = [
        ("elbow", Kind::JointDelta),
        ("wrist", Kind::JointVelocity),
        ("hand", Kind::JointPosition),
    ];
    let mut adapter = adapter(&kinds, GripperSource::Open);
    for ms in (0..=600).step_by(50) {
        let at = elbow(ms);
        let state = state(ms, &[("wrist", at), ("elbow", at), ("hand", at)]);
        adapter.joints(&state, 0).unwrap();
    }
    let found = actions(&mut adapter);
    assert_eq!(found.len(), 3);
    for (began_ms, values) in found {
        let moved = elbow(began_ms + 200) - elbow(began_ms);
        let expected = [moved, moved / 0.2, elbow(began_ms + 150)];
        for (found, expected) in values.iter().zip(expected) {
            assert!((f64::from(*found) - expected).abs() < 1e-5, "{values:?}");
        }
    }
}

#[test]
fn gripper_comes_from_its_own_source_or_a_joint_of_its_name() {
    let kinds = [
        ("gripper", Kind::GripperContinuous),
        ("elbow", Kind::JointDelta),
    ];
    let finger = GripperSource::Joint {
        name: "finger".into(),
        closed: 0.0,
        open: 0.04,
    };
    let mut own = adapter(&kinds, finger);
    for ms in [0, 200] {
        let opening = own.joints(&state(ms, &[("elbow", 0.1), ("finger", 0.01)]), 0);
        assert_eq!(opening, Ok(Some(0.25)));
    }
    assert_eq!(actions(&mut own), [(0, vec![0.25, 0.0])]);

    let mut joint = adapter(&kinds, GripperSource::Open);
    for ms in [0, 200] {
        joint
            .joints(&state(ms, &[("elbow", 0.1), ("gripper", 0.75)]), 0)
            .unwrap();
    }
    assert_eq!(actions(&mut joint), [(0, vec![0.75, 0.0])]);

    // A topic of which nothing has arrived.
    let mut topic = adapter(&kinds, GripperSource::Topic);
    for ms in [0, 200] {
        topic.joints(&state(ms, &[("elbow", 0.1)]), 0).unwrap();
    }
    assert_eq!(topic.take_done(), [Err(Problem::NoGripper)]);
}

#[test]
fn gaps_jumps_and_bad_values_begin_anew_and_are_named() {
    let mut adapter = adapter(&[("elbow", Kind::JointDelta)], GripperSource::Open);
    let mut take = |ms: i64, at: f64| {
        adapter.joints(&state(ms, &[("elbow", at)]), 0).unwrap();
        let done = adapter.take_done().into_iter();
        let done = done.map(|done| match done {
            Ok(done) => ("done", (done.stamp_ns - START) / MS, done.values),
            Err(problem) => (problem.reason(), problem.count() as i64, Vec::new()),
        });
        done.collect::<Vec<_>>()
    };
    assert_eq!(take(0, 0.0), []);
    assert_eq!(take(100, 0.25), []);
    assert_eq!(take(90, 0.0), [("older", 1, vec![])]);
    assert_eq!(take(200, 0.5), [("done", 0, vec![0.5])]);
    // The silence is longer than the timeout of 500 ms.
    assert_eq!(take(1000, 1.0), [("gap", 4, vec![])]);
    assert_eq!(take(1200, 1.5), [("done", 1000, vec![0.5])]);
    assert_eq!(take(1300, f64::NAN), [("not_finite", 1, vec![])]);
    assert_eq!(take(1400, 1.5), [("not_finite", 1, vec![])]);
    assert_eq!(take(1600, 1.75), [("done", 1400, vec![0.25])]);
    // Too fast for any arm.
    assert_eq!(take(1800, 9.0), [("out_of_bounds", 1, vec![])]);
    // A bag begins again, twice.
    assert_eq!(take(100, 0.0), [("clock_jumped", 1, vec![])]);
    assert_eq!(take(300, 0.25), [("done", 100, vec![0.25])]);
    for _ in 0..2 {
        assert_eq!(take(0, 0.5), [("clock_jumped", 1, vec![])]);
        assert_eq!(take(5000, 0.5), [("gap", 25, vec![])]);
    }
}

#[test]
fn missing_joint_is_named() {
    let mut adapter = adapter(
        &[("elbow", Kind::JointDelta), ("wrist", Kind::JointDelta)],
        GripperSource::Open,
    );
    assert_eq!(adapter.missing_joint(), None);
    adapter.joints(&state(0, &[("elbow", 0.0)]), 0).unwrap();
    assert_eq!(adapter.missing_joint().unwrap().name, "wrist");
    assert!(adapter.tick(START + 300 * MS));
    adapter
        .joints(&state(200, &[("elbow", 0.0), ("wrist", 0.0)]), 0)
        .unwrap();
    assert_eq!(adapter.missing_joint(), None);
}

#[test]
fn other_spaces_are_refused() {
    let error = JointSpace::new(ActionSpace::bridge(), false).unwrap_err();
    assert!(error.to_string().contains("bridge_v2: dx"), "{error}");
    let gripper = space(&[("gripper", Kind::GripperBinary)]);
    assert!(JointSpace::new(gripper.clone(), false).is_ok());
    assert!(JointSpace::new(gripper, true).is_err(), "nothing moves");
}
