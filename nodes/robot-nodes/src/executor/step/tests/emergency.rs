//! The topic of the emergency stop: who is connected.

use wm_ros::PublisherId;

use super::*;
use crate::executor::StopSources;

fn sources(publishers: &[u8], mismatches: &[&str]) -> StopSources {
    StopSources {
        connected: publishers.iter().map(|id| PublisherId([*id; 16])).collect(),
        mismatches: mismatches.iter().map(|text| (*text).to_owned()).collect(),
    }
}

const MISMATCH: &str = "a publisher has the type std_msgs/msg/String";

#[test]
fn a_stop_that_cannot_be_connected_keeps_the_arm_disarmed() {
    let mut bench = Bench::new(settings());
    bench.step.stop_sources(sources(&[1], &[MISMATCH]));
    let refused = bench.step.arm().unwrap_err();
    assert_eq!(refused, ArmError::StopMismatch(MISMATCH.into()));
    assert_eq!(bench.state(), State::DryRun);
    bench.step.stop_sources(sources(&[1], &[]));
    bench.step.arm().unwrap();
}

#[test]
fn a_stop_that_cannot_be_connected_disarms() {
    let mut bench = Bench::moving(settings());
    bench.step.stop_sources(sources(&[], &[MISMATCH]));
    assert!(bench.reason().contains(MISMATCH), "{}", bench.reason());
    bench.expect_stop(450);
    assert_eq!(bench.state(), State::DryRun);
}

#[test]
fn a_stop_that_is_lost_disarms() {
    let mut bench = Bench::armed(settings());
    bench.step.stop_sources(sources(&[1], &[]));
    bench.set_going();
    // Another one does not replace it.
    bench.step.stop_sources(sources(&[1, 2], &[]));
    assert_eq!(bench.state(), State::Executing);
    bench.step.stop_sources(sources(&[2], &[]));
    assert!(bench.reason().contains("is gone"), "{}", bench.reason());
    bench.expect_stop(450);
    assert_eq!(bench.state(), State::DryRun);
    // The person who arms it again knows.
    bench.step.arm().unwrap();
}

#[test]
fn one_publisher_does_not_release_what_another_presses() {
    let mut bench = Bench::armed(settings());
    let other = PublisherId([2; 16]);
    bench.step.stop_sources(sources(&[1, 2], &[]));
    bench.step.emergency(BUTTON, true);
    bench.step.emergency(other, false);
    assert_eq!(bench.step.reset(), Err(ArmError::Pressed));
    bench.step.emergency(BUTTON, false);
    bench.step.reset().unwrap();
    // A publisher that has gone cannot release it: another one, as its successor, does.
    bench.step.emergency(BUTTON, true);
    bench.step.stop_sources(sources(&[2], &[]));
    assert_eq!(bench.step.reset(), Err(ArmError::Pressed));
    bench.step.emergency(other, false);
    bench.step.reset().unwrap();
}

#[test]
fn a_stop_that_is_required_must_be_there() {
    let mut bench = Bench::new(Settings {
        emergency: EmergencyStop::new(true),
        ..settings()
    });
    assert_eq!(bench.step.arm(), Err(ArmError::NoStop));
    bench.step.stop_sources(sources(&[1], &[]));
    bench.step.arm().unwrap();
    bench.step.stop_sources(sources(&[], &[]));
    bench.run(0, 100);
    assert_eq!(bench.state(), State::DryRun);
    assert_eq!(bench.step.arm(), Err(ArmError::NoStop));
}
