//! Arms that are commanded by joints.

use proptest::prelude::*;
use wm_motion::actions::{Dimension, Kind};

use super::*;
use crate::executor::Group;

const SHOULDER: (f64, f64) = (1.0, 8.0);
const ELBOW: (f64, f64) = (0.5, 4.0);

fn space(kind: Kind) -> ActionSpace {
    let dimension = |name: &str, kind| Dimension {
        name: name.into(),
        unit: "rad".into(),
        kind,
        offset: 0.0,
        scale: 1.0,
        clip: 2.0,
    };
    let dimensions = vec![
        dimension("shoulder", kind),
        dimension("elbow", kind),
        dimension("gripper", Kind::GripperContinuous),
    ];
    ActionSpace::new("joints".into(), 5.0, dimensions).unwrap()
}

fn of_joints(kind: Kind) -> Settings {
    let group = |(velocity, acceleration)| Group {
        axes: 1,
        velocity,
        acceleration,
    };
    let mut settings = Settings {
        layout: Layout::of_joints(space(kind)).unwrap(),
        limits: Limits::new(vec![group(SHOULDER), group(ELBOW)]),
        joints: Some(Joints::new(
            vec!["shoulder".into(), "elbow".into()],
            vec![(-1.0, 1.0), (-2.0, 2.0)],
            Duration::from_millis(300),
            Duration::from_millis(200),
            0.2,
        )),
        ..settings()
    };
    settings.bounds.joints = vec![0.4, 0.4];
    settings
}

fn state(places: &[f64]) -> JointState {
    JointState {
        name: vec!["elbow".into(), "shoulder".into()],
        position: places.iter().rev().copied().collect(),
        ..JointState::default()
    }
}

fn offer_of(stamp_ms: i64, actions: &[[f32; 3]]) -> ActionChunk {
    let mut chunk = chunk(stamp_ms, 0.0, actions.len());
    for (action, values) in chunk.actions.iter_mut().zip(actions) {
        action.values = values.to_vec();
    }
    chunk
}

/// An arm that follows its commands, or does not move.
struct Arm {
    bench: Bench,
    places: Vec<f64>,
    velocity: Vec<f64>,
    is_stuck: bool,
}

impl Arm {
    fn new(kind: Kind) -> Self {
        Self {
            bench: Bench::armed(of_joints(kind)),
            places: vec![0.0; 2],
            velocity: vec![0.0; 2],
            is_stuck: false,
        }
    }

    fn measure(&mut self, ms: i64) {
        let received = self.bench.at(ms);
        self.bench
            .step
            .joints(&state(&self.places), received)
            .unwrap();
    }

    /// A command period: whether anything was sent, and that it keeps to the limits.
    fn tick(&mut self, ms: i64) -> bool {
        self.measure(ms);
        let Output::Send(command) = self.bench.tick(ms) else {
            self.velocity = vec![0.0; 2];
            return false;
        };
        let places = command.places.unwrap();
        for (axis, (most, change)) in [SHOULDER, ELBOW].into_iter().enumerate() {
            let (velocity, before) = (command.velocity.as_slice()[axis], self.velocity[axis]);
            assert!(velocity.abs() <= most + 1e-9, "{velocity}");
            assert!(
                (velocity - before).abs() <= change * 0.05 + 1e-9,
                "{velocity} after {before}"
            );
            let way = places.as_slice()[axis] - self.places[axis];
            assert!(
                self.is_stuck || (way - velocity * 0.05).abs() < 1e-9,
                "{way}"
            );
        }
        if !self.is_stuck {
            self.places = places.as_slice().to_vec();
        }
        self.velocity = command.velocity.as_slice().to_vec();
        true
    }

    fn run(&mut self, from_ms: i64, to_ms: i64) {
        for ms in (from_ms..to_ms).step_by(50) {
            self.tick(ms);
        }
    }
}

#[test]
fn deltas_of_joints_are_positions_on_the_way() {
    let mut arm = Arm::new(Kind::JointDelta);
    let chunk = offer_of(0, &[[0.1, -0.04, 0.3]; 4]);
    assert_eq!(arm.bench.refused(0, &chunk).0, "no_joints");
    arm.measure(0);
    arm.bench.offer(0, &chunk).unwrap();
    arm.run(0, 800);
    assert_eq!(arm.bench.state(), State::Executing);
    // Less what it takes to get going.
    assert!((0.36..=0.4).contains(&arm.places[0]), "{:?}", arm.places);
    assert!((-0.16..=-0.15).contains(&arm.places[1]), "{:?}", arm.places);
    arm.run(800, 1_000);
    assert_eq!(arm.velocity, [0.0; 2]);
    arm.run(1_000, 1_600);
    assert!(!arm.tick(1_600));
    assert_eq!(arm.bench.state(), State::Idle);
}

#[test]
fn positions_of_joints_are_attained_at_the_end_of_their_actions() {
    let mut arm = Arm::new(Kind::JointPosition);
    arm.places = vec![0.2, -0.3];
    arm.measure(0);
    let chunk = offer_of(
        0,
        &[[0.3, -0.35, 1.0], [0.35, -0.35, 1.0], [0.35, -0.35, 1.0]],
    );
    arm.bench.offer(0, &chunk).unwrap();
    for (ms, expected) in [
        (200, [0.3, -0.35]),
        (400, [0.35, -0.35]),
        (600, [0.35, -0.35]),
    ] {
        arm.run(ms - 200, ms);
        for (found, expected) in arm.places.iter().zip(expected) {
            assert!(
                (found - expected).abs() < 1e-2,
                "{:?} after {ms} ms",
                arm.places
            );
        }
    }
}

#[test]
fn what_joints_cannot_or_may_not_do_is_refused_by_name() {
    let mut arm = Arm::new(Kind::JointPosition);
    arm.measure(0);
    let mut refused = |actions: &[[f32; 3]]| arm.bench.refused(0, &offer_of(0, actions));
    for (actions, named) in [
        (
            vec![[0.5, 0.0, 1.0]],
            "shoulder is to move by 0.5000; at most 0.4000",
        ),
        (vec![[0.0, 0.3, 1.0], [0.0, -0.3, 1.0]], "action 1: elbow"),
        (
            vec![[0.4, 0.0, 1.0], [0.8, 0.0, 1.0], [1.1, 0.0, 1.0]],
            "action 2: shoulder is to be at 1.1",
        ),
    ] {
        let (reason, text) = refused(&actions);
        assert_eq!(reason, "out_of_bounds", "{text}");
        assert!(text.contains(named), "{text}");
    }
    let mut arm = Arm::new(Kind::JointDelta);
    arm.measure(0);
    let (reason, text) = arm.bench.refused(0, &offer_of(0, &[[0.0, 0.5, 1.0]]));
    assert_eq!(reason, "out_of_bounds");
    assert!(text.contains("elbow is 0.5000 rad"), "{text}");
}

#[test]
fn a_joint_stops_at_its_limit() {
    let mut arm = Arm::new(Kind::JointDelta);
    arm.places = vec![0.8, 0.0];
    for ms in (0..3_000).step_by(50) {
        arm.measure(ms);
        if ms % 500 == 0 {
            arm.bench
                .offer(ms, &offer_of(ms, &[[0.2, 0.0, 1.0]; 4]))
                .unwrap();
        }
        arm.tick(ms);
        assert!(arm.places[0] <= 1.0 + 1e-9, "{:?}", arm.places);
    }
    assert!(arm.places[0] > 0.99, "{:?}", arm.places);
    assert!(
        arm.bench.reason().contains("limits"),
        "{}",
        arm.bench.reason()
    );
}

#[test]
fn without_joint_states_it_stops() {
    let mut arm = Arm::new(Kind::JointDelta);
    arm.measure(0);
    arm.bench
        .offer(0, &offer_of(0, &[[0.1, 0.0, 1.0]; 20]))
        .unwrap();
    arm.run(0, 400);
    // They are silent from now on.
    let mut last = None;
    for ms in (400..1_000).step_by(50) {
        last = match arm.bench.tick(ms) {
            Output::Send(command) => Some(command.velocity.is_zero()),
            _ => None,
        };
    }
    assert_eq!(last, Some(true));
    assert!(
        arm.bench.reason().contains("joint_states"),
        "{}",
        arm.bench.reason()
    );
}

#[test]
fn an_arm_that_does_not_follow_is_told_to_stop() {
    let mut arm = Arm::new(Kind::JointDelta);
    arm.is_stuck = true;
    arm.measure(0);
    arm.bench
        .offer(0, &offer_of(0, &[[0.1, 0.0, 1.0]; 20]))
        .unwrap();
    arm.run(0, 1_000);
    assert_eq!(arm.velocity, [0.0; 2]);
    assert!(
        arm.bench.reason().contains("max_joint_error"),
        "{}",
        arm.bench.reason()
    );
    assert_eq!(arm.bench.step.status().counts.interrupted, 1);
}

proptest! {
    /// [`Arm::tick`] asserts the limits of velocity and acceleration.
    #[test]
    fn whatever_comes_joints_keep_to_their_limits(
        offers in prop::collection::vec(
            (prop::collection::vec(prop::array::uniform2(-0.4_f32..0.4), 1..5), -200_i64..200, 1_usize..12),
            1..20,
        ),
        are_positions in any::<bool>(),
    ) {
        let kind = if are_positions { Kind::JointPosition } else { Kind::JointDelta };
        let mut arm = Arm::new(kind);
        let mut ms = 0;
        for (actions, ahead_ms, ticks) in offers {
            let actions: Vec<_> = actions.into_iter().map(|[a, b]| [a, b, 1.0]).collect();
            arm.measure(ms);
            arm.bench.offer(ms, &offer_of(ms + ahead_ms, &actions)).ok();
            for _ in 0..ticks {
                arm.tick(ms);
                ms += 50;
                prop_assert!(arm.places[0].abs() <= 1.0 + 1e-9, "{:?}", arm.places);
            }
        }
        arm.bench.step.disarm(Cause::Disarmed);
        for _ in 0..4 {
            arm.tick(ms);
            ms += 50;
        }
        prop_assert_eq!(&arm.velocity, &[0.0; 2]);
    }
}
