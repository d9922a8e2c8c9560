//! Poses, transforms and twists beyond what the arm can do in a period.

use super::*;

/// The hand, `by` further forward than it is.
fn apart(ms: i64, by: f64) -> PoseStamped {
    let mut pose = pose(ms);
    pose.pose.position.x += by;
    pose
}

#[test]
fn a_pose_that_leaps_is_dropped_and_counted() {
    for period_ms in [20, 50, 100, 200] {
        let mut adapter = adapter(MotionSource::Pose);
        let mut dropped = 0;
        for tick in 0..2_000 / period_ms {
            let ms = tick * period_ms;
            let is_off = tick % 5 == 3;
            let taken = adapter.pose(&apart(ms, f64::from(u8::from(is_off))), 0);
            let reason = taken.map_err(|problem| problem.reason());
            assert_eq!(reason, if is_off { Err("pose_leapt") } else { Ok(()) });
            dropped += i32::from(is_off);
        }
        assert!(dropped > 0);
        let (moved, _) = sum(&actions(&mut adapter));
        let ms = (2_000 - period_ms) / 200 * 200;
        let way = hand(ms).translation.vector - hand(0).translation.vector;
        assert!((moved - way).norm() < 5e-3, "{moved} for {way}");
    }
}

#[test]
fn a_turn_that_leaps_is_dropped() {
    let mut adapter = adapter(MotionSource::Pose);
    adapter.pose(&pose(0), 0).unwrap();
    let mut turned = pose(100);
    let half = UnitQuaternion::from_euler_angles(0.0, 0.0, 1.5) * hand(100).rotation;
    turned.pose = pose_message(&Isometry3::from_parts(hand(100).translation, half));
    let problem = adapter.pose(&turned, 0).unwrap_err();
    assert_eq!((problem.reason(), problem.count()), ("pose_leapt", 1));
    assert!(problem.to_string().contains("1.4"), "{problem}");
    // The same orientation by the opposite quaternion is no turn.
    let mut same = pose(120);
    let turn = &mut same.pose.orientation;
    (turn.x, turn.y, turn.z, turn.w) = (-turn.x, -turn.y, -turn.z, -turn.w);
    adapter.pose(&same, 0).unwrap();
}

#[test]
fn poses_that_stay_where_they_leapt_to_begin_anew() {
    for by in [1.0, 0.5, -0.3] {
        let mut adapter = adapter(MotionSource::Pose);
        for ms in [0, 50, 100, 150] {
            adapter.pose(&pose(ms), 0).unwrap();
        }
        let reasons: Vec<_> = [200, 250, 300, 350, 400, 450, 500]
            .map(|ms| adapter.pose(&apart(ms, by), 0))
            .into_iter()
            .map(|taken| taken.map_err(|problem| problem.reason()))
            .collect();
        let (leapt, moved) = (Err("pose_leapt"), Err("pose_moved"));
        assert_eq!(reasons[..3], [leapt, leapt, moved]);
        assert_eq!(reasons[3..], [Ok(()); 4]);
        let done = actions(&mut adapter);
        assert_eq!(done.len(), 1);
        assert_eq!(done[0].0, 300);
        assert!(done[0].1[0].abs() < 0.05, "{done:?}");
    }
}

/// Other transforms come between those of the arm, and each message is followed.
#[test]
fn transforms_that_leap_are_counted_once_and_not_published() {
    let send = |adapter: &mut AdapterStep, frame: TransformStamped| {
        let message = TFMessage {
            transforms: vec![frame],
        };
        assert_eq!(adapter.transforms(&message, false), []);
        adapter
            .follow()
            .unwrap()
            .map(|(_, pose)| pose.translation.x)
    };
    let leapt = |by: f64| {
        let mut adapter = frames();
        send(&mut adapter, frame(0, "base_link", "tool", &hand(0)));
        let mut given = Vec::new();
        for ms in [50, 100, 150, 200] {
            let at = Isometry3::translation(by, 0.0, 0.0) * hand(ms);
            given.push(send(&mut adapter, frame(ms, "base_link", "tool", &at)));
            let wheel = frame(ms + 10, "base_link", "wheel", &hand(0));
            assert_eq!(send(&mut adapter, wheel), None);
        }
        let done = adapter.take_done().into_iter();
        let reasons: Vec<_> = done
            .filter_map(|done| done.err().map(|problem| problem.reason()))
            .collect();
        (given.iter().map(Option::is_some).collect(), reasons)
    };
    let (given, reasons): (Vec<bool>, _) = leapt(1.0);
    assert_eq!(given, [false, false, true, true]);
    assert_eq!(reasons, ["pose_leapt", "pose_leapt", "pose_moved"]);
    assert_eq!(leapt(0.0), (vec![true; 4], Vec::new()));
}

#[test]
fn a_twist_that_the_arm_cannot_do_is_dropped() {
    let mut adapter = adapter(MotionSource::Twist);
    adapter.twist(&twist(0, 0.1), 0).unwrap();
    let problem = adapter.twist(&twist(50, 2.5), 0).unwrap_err();
    assert_eq!(problem.reason(), "too_fast");
    adapter.twist(&twist(200, 0.1), 0).unwrap();
    assert!((actions(&mut adapter)[0].1[0] - 0.02).abs() < 1e-6);
}
