//! Stamps with a nanosec of a second or more, and invalid orientations.

use wm_msgs::wm_msgs::{ActionCandidates, CameraState};

use super::*;

const MALFORMED: u32 = 1_999_999_999;

#[test]
fn a_malformed_stamp_is_refused_wherever_it_is() {
    let mut bench = Bench::armed(settings());
    let changes: [fn(&mut ActionChunk); 4] = [
        |chunk| chunk.header.stamp.nanosec = MALFORMED,
        |chunk| chunk.period.nanosec = MALFORMED,
        |chunk| chunk.actions[1].header.stamp.nanosec = MALFORMED,
        |chunk| chunk.timing.capture.nanosec = MALFORMED,
    ];
    for change in changes {
        let mut chunk = chunk(0, 0.02, 4);
        change(&mut chunk);
        let (reason, text) = bench.refused(0, &chunk);
        assert_eq!(reason, "bad_stamp");
        assert!(text.contains("1999999999"), "{text}");
    }
    let changes: [fn(&mut Plan); 4] = [
        |plan| plan.header.stamp.nanosec = MALFORMED,
        |plan| plan.period.nanosec = MALFORMED,
        |plan| plan.actions[0].header.stamp.nanosec = MALFORMED,
        |plan| plan.actions[1].header.stamp.nanosec = 1_000_000_000,
    ];
    let now = bench.at(0);
    for change in changes {
        let mut plan = plan(0, 1);
        change(&mut plan);
        let refused = bench.step.plan(&plan, now, now).unwrap_err();
        assert_eq!(refused.reason(), "bad_stamp");
    }
    assert_eq!(bench.step.status().counts.refused, 8);
    assert_eq!(bench.run(0, 300), None);

    let stamp = Time {
        sec: 5,
        nanosec: MALFORMED,
    };
    let mut candidates = ActionCandidates::default();
    candidates.header.stamp = stamp;
    assert!(bench.step.candidates(&candidates).is_err());
    let assessment = Assessment {
        candidates_stamp: stamp,
        ..Assessment::default()
    };
    assert_eq!(bench.step.assessment(&assessment, now).len(), 1);
    let mut camera = CameraState::default();
    camera.header.stamp = stamp;
    assert!(bench.step.camera(&camera, now).is_err());
    assert!(bench.offer(0, &chunk(0, 0.02, 4)).is_ok());
    // A stop counts all the same.
    camera.frozen = true;
    assert!(bench.step.camera(&camera, now).is_err());
    assert_eq!(bench.refused(0, &chunk(0, 0.02, 4)).0, "camera_frozen");
}

#[test]
fn a_pose_without_an_orientation_is_dropped() {
    let mut bench = Bench::armed(in_a_box());
    let now = bench.at(0);
    let mut refused = |change: &dyn Fn(&mut PoseStamped)| {
        let mut pose = pose(0.0);
        change(&mut pose);
        bench.step.pose(&pose, now).map_err(|error| error.reason())
    };
    let pose_error = Err("pose");
    assert_eq!(refused(&|pose| pose.pose.position.y = f64::NAN), pose_error);
    assert_eq!(
        refused(&|pose| pose.pose.orientation.x = f64::NAN),
        pose_error
    );
    assert_eq!(refused(&|pose| pose.pose.orientation.w = 0.98), pose_error);
    let bad_stamp = Err("bad_stamp");
    assert_eq!(
        refused(&|pose| pose.header.stamp.nanosec = MALFORMED),
        bad_stamp
    );
    assert_eq!(refused(&|pose| pose.pose.orientation.w = 0.9985), Ok(()));
}
