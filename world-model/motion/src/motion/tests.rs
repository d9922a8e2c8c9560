#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use proptest::prelude::*;

use super::*;
use crate::actions::{Accumulation, Dimension, Kind};

/// One frame of a 5 Hz camera \[ns\].
const FRAME: i64 = 200_000_000;
const START: i64 = 1_700_000_000_000_000_000;

fn motion() -> Motion {
    Motion::new(MotionSettings::of_period(FRAME))
}

fn along_x(metres: f32) -> Arc<[f32]> {
    [metres, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0].into()
}

fn chunk(stamp_ns: i64, period_ns: i64, metres: &[f32]) -> Chunk {
    let actions = metres.iter().map(|metres| along_x(*metres)).collect();
    Chunk::new(&ActionSpace::bridge(), stamp_ns, period_ns, actions).unwrap()
}

fn x_of(motion: &Motion, from_ns: i64, to_ns: i64) -> f32 {
    let interval = motion.between(&ActionSpace::bridge(), from_ns, to_ns);
    interval.unwrap().values[0]
}

/// An arm that moves at constant velocity over each frame.
#[derive(Clone, Debug)]
struct Trajectory {
    /// Translation \[m\], rotation \[rad\] and gripper of each frame.
    frames: Vec<([f32; 3], [f32; 3], bool)>,
}

impl Trajectory {
    fn any() -> impl Strategy<Value = Self> {
        let frame = (
            prop::array::uniform3(-0.04_f32..0.04),
            prop::array::uniform3(-0.2_f32..0.2),
            any::<bool>(),
        );
        prop::collection::vec(frame, 4).prop_map(|frames| Self { frames })
    }

    /// The motion published with a message at each of `stamps`, which include the start of every frame.
    fn publish(&self, stamps: &[i64]) -> Motion {
        let mut motion = motion();
        for (from, to) in stamps.iter().zip(&stamps[1..]) {
            let frame = usize::try_from((from - START) / FRAME).unwrap();
            let Some((translation, rotation, open)) = self.frames.get(frame) else {
                break;
            };
            let share = (to - from) as f64 / FRAME as f64;
            let turned = rotation::to_angles(&rotation::share(*rotation, share));
            let mut values = [0.0; 7];
            for (value, metres) in values.iter_mut().zip(translation) {
                *value = metres * share as f32;
            }
            values[3..6].copy_from_slice(&turned);
            values[6] = f32::from(*open);
            motion.take(*from, values.into());
        }
        // Ends the last action.
        motion.take(START + 4 * FRAME, [0.0; 7].into());
        motion
    }

    fn steps(motion: &Motion) -> Vec<Vec<f32>> {
        let encoding = ActionEncoding::default();
        let begins = [START, START + 2 * FRAME];
        let step = |begin: i64| motion.step(&encoding, begin, begin + 2 * FRAME);
        begins.map(|begin| step(begin).unwrap().model.values).into()
    }
}

proptest! {
    #[test]
    fn model_action_is_the_same_at_any_action_rate(
        trajectory in Trajectory::any(),
        jitter in prop::collection::vec(0.1_f64..0.9, 20),
    ) {
        let steps_at = |per_frame: i64| {
            let ticks = 0..=4 * per_frame;
            let stamps: Vec<i64> = ticks.map(|tick| START + tick * FRAME / per_frame).collect();
            Trajectory::steps(&trajectory.publish(&stamps))
        };
        let expected = steps_at(1);
        let mut jittering: Vec<i64> = (0..=4).map(|frame| START + frame * FRAME).collect();
        jittering.extend(jitter.iter().zip(0_i64..).map(|(part, index)| {
            START + index % 4 * FRAME + (part * FRAME as f64) as i64
        }));
        jittering.sort_unstable();
        jittering.dedup();
        let jittering = Trajectory::steps(&trajectory.publish(&jittering));
        for found in [steps_at(2), steps_at(6), steps_at(10), jittering] {
            for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
                prop_assert!((found - expected).abs() < 1e-5, "{found} {expected}");
            }
        }
    }

    #[test]
    fn announced_plan_gives_its_own_model_action(
        translation in prop::array::uniform3(-1.7_f32..1.7),
        rotation in prop::array::uniform3(-1.3_f32..1.3),
        open in any::<bool>(),
        rule in prop_oneof![Just(Accumulation::Mean), Just(Accumulation::Sum), Just(Accumulation::Index)],
        late_ns in -40_000_000_i64..40_000_000,
    ) {
        let encoding = ActionEncoding::new(ActionSpace::bridge(), 7, 2, rule).unwrap();
        let mut planned = [translation, rotation].concat();
        planned.push(if open { -1.0 } else { 1.0 });
        let action: Arc<[f32]> = encoding.decode_step(&planned).unwrap().into();
        let chunk = Chunk::new(encoding.space(), START, 2 * FRAME, vec![action.clone(), action]).unwrap();
        let mut motion = motion();
        // Earlier actions do not affect the plan, even with jittering stamps.
        motion.take(START - FRAME + late_ns, along_x(0.04));
        motion.announce(chunk, encoding.space());
        let step = motion.step(&encoding, START, START + 2 * FRAME).unwrap();
        prop_assert!(step.is_given());
        for (found, planned) in step.model.values.iter().zip(&planned) {
            prop_assert!((found - planned).abs() < 1e-5, "{found} {planned}");
        }
    }
}

#[test]
fn a_slow_delta_counts_once() {
    let mut motion = motion();
    for index in 0..3 {
        motion.take(START + index * 2 * FRAME, along_x(0.02));
    }
    assert_eq!(x_of(&motion, START, START + FRAME), 0.01);
    assert_eq!(x_of(&motion, START, START + 2 * FRAME), 0.02);
    assert_eq!(x_of(&motion, START + FRAME, START + 3 * FRAME), 0.02);
}

#[test]
fn partly_overlapping_action_counts_in_part() {
    let mut motion = motion();
    motion.take(START, along_x(0.02));
    motion.take(START + FRAME, along_x(0.04));
    let x = x_of(&motion, START + FRAME / 2, START + FRAME * 3 / 2);
    assert!((x - 0.03).abs() < 1e-7, "{x}");
}

#[test]
fn rotations_compose_about_fixed_axes() {
    let quarter = std::f32::consts::FRAC_PI_2;
    let mut motion = motion();
    motion.take(START, [0.0, 0.0, 0.0, quarter, 0.0, 0.0, 0.0].into());
    motion.take(
        START + FRAME,
        [0.0, 0.0, 0.0, 0.0, 0.0, quarter, 0.0].into(),
    );
    let interval = motion
        .between(&ActionSpace::bridge(), START, START + 2 * FRAME)
        .unwrap();
    let found = rotation::from_angles(interval.values[3..6].try_into().unwrap());
    let expected =
        rotation::from_angles([0.0, 0.0, quarter]) * rotation::from_angles([quarter, 0.0, 0.0]);
    assert!(found.angle_to(&expected) < 1e-6);
}

#[test]
fn gripper_is_the_last_state() {
    let mut motion = motion();
    motion.take(START, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0].into());
    motion.take(START + FRAME * 3 / 5, [0.0; 7].into());
    let gripper = |from_ns| {
        let interval = motion.between(&ActionSpace::bridge(), from_ns, from_ns + FRAME);
        interval.unwrap().values[6]
    };
    assert_eq!(gripper(START), 0.0);
    assert_eq!(gripper(START - FRAME / 5), 1.0);
}

#[test]
fn last_action_is_held_and_reported_as_not_given() {
    let mut motion = motion();
    motion.take(START, along_x(0.01));
    motion.take(START + FRAME, along_x(0.02));
    let space = ActionSpace::bridge();
    let newest = motion
        .between(&space, START + FRAME, START + 2 * FRAME)
        .unwrap();
    assert_eq!((newest.values[0], newest.is_given), (0.02, true));
    let later = motion
        .between(&space, START + 9 * FRAME, START + 10 * FRAME)
        .unwrap();
    assert!((later.values[0] - 0.02).abs() < 1e-7 && !later.is_given);
    assert_eq!(motion.between(&space, START - FRAME, START), None);
}

#[test]
fn robot_stands_still_between_distant_actions() {
    let mut motion = motion();
    motion.take(START, along_x(0.05));
    motion.take(START + 100 * FRAME, along_x(0.02));
    // The first motion is over within the longest time, a second.
    assert!((x_of(&motion, START, START + 5 * FRAME) - 0.05).abs() < 1e-7);
    assert_eq!(x_of(&motion, START + 50 * FRAME, START + 51 * FRAME), 0.0);
}

#[test]
fn executed_actions_win_over_announced_ones() {
    let mut motion = motion();
    motion.announce(
        chunk(START, FRAME, &[0.01, 0.02, 0.03]),
        &ActionSpace::bridge(),
    );
    motion.take(START, along_x(-0.05));
    assert_eq!(x_of(&motion, START, START + FRAME), -0.05);
    assert_eq!(x_of(&motion, START + FRAME, START + 2 * FRAME), 0.02);
    // Ten milliseconds late, the second action still replaces the announced one.
    motion.take(START + FRAME + 10_000_000, along_x(0.0));
    assert!((x_of(&motion, START + 2 * FRAME, START + 3 * FRAME) - 0.03).abs() < 1e-7);
}

#[test]
fn newer_chunk_replaces_only_later_actions() {
    let mut motion = motion();
    let space = ActionSpace::bridge();
    motion.announce(chunk(START, FRAME, &[0.01, 0.02, 0.03]), &space);
    motion.announce(chunk(START + FRAME, FRAME, &[0.05]), &space);
    assert_eq!(x_of(&motion, START, START + FRAME), 0.01);
    assert_eq!(x_of(&motion, START + FRAME, START + 2 * FRAME), 0.05);
}

#[test]
fn chunks_are_merged_by_the_rule() {
    let space = ActionSpace::bridge();
    for (merging, expected) in [
        (ChunkMerging::Latest, 0.04),
        (ChunkMerging::Weighted, 0.3 * 0.02 + 0.7 * 0.04),
        (ChunkMerging::Average, 0.03),
    ] {
        let mut motion = motion().with_merging(merging);
        motion.announce(chunk(START, 2 * FRAME, &[0.04, 0.04]), &space);
        // In the time of one newer action, the older chunk moves by 0.02.
        motion.announce(chunk(START + FRAME, FRAME, &[0.04, 0.04]), &space);
        let x = x_of(&motion, START + FRAME, START + 2 * FRAME);
        assert!((x - expected).abs() < 1e-7, "{merging:?}: {x}");
    }
}

#[test]
fn invalid_chunks_are_rejected_by_name() {
    let space = ActionSpace::bridge();
    let chunk =
        |count: usize, period_ns| Chunk::new(&space, START, period_ns, vec![along_x(0.0); count]);
    for (count, period_ns) in [
        (0, FRAME),
        (MAX_CHUNK + 1, FRAME),
        (1, 1),
        (1, 0),
        (1, -FRAME),
        (1, i64::MAX),
    ] {
        let error = chunk(count, period_ns).unwrap_err();
        assert_eq!(error, ActionError::Chunk { count, period_ns });
    }
    let error = Chunk::new(&space, START, FRAME, vec![along_x(1e38)]).unwrap_err();
    assert!(error.to_string().contains("dx"), "{error}");
}

#[test]
fn states_hold_and_joints_add_up() {
    let dimension = |name: &str, kind| Dimension {
        name: name.into(),
        unit: "rad".into(),
        kind,
        offset: 0.0,
        scale: 1.0,
        clip: 10.0,
    };
    let kinds = [("elbow", Kind::JointPosition), ("wrist", Kind::JointDelta)];
    let dimensions = kinds.map(|(name, kind)| dimension(name, kind)).to_vec();
    let space = ActionSpace::new("two".into(), 10.0, dimensions).unwrap();
    let mut motion = motion();
    motion.take(START, [1.0, 0.5].into());
    motion.take(START + FRAME, [2.0, 0.25].into());
    let interval = motion.between(&space, START, START + 2 * FRAME).unwrap();
    assert_eq!(interval.values, [2.0, 0.75]);
}

#[test]
fn memory_is_bounded() {
    let mut motion = motion();
    for index in 0..20_000_i64 {
        motion.take(START + index, along_x(0.0));
        motion.announce(
            chunk(START + index, 1_000_000, &[0.0; 64]),
            &ActionSpace::bridge(),
        );
    }
    assert!(motion.pieces().len() < 20_000);
}

#[test]
fn stamps_at_the_ends_of_time_do_not_overflow() {
    let mut motion = motion();
    for stamp_ns in [i64::MIN, i64::MIN + 1, -1, 0, i64::MAX - 1, i64::MAX] {
        motion.take(stamp_ns, along_x(0.01));
    }
    let _ = motion.between(&ActionSpace::bridge(), START, START + FRAME);
    motion.retain_around(i64::MIN, FRAME);
    motion.retain_around(i64::MAX, FRAME);
}

proptest! {
    #[test]
    fn velocity_integral_is_the_same_at_any_rate(
        frames in prop::collection::vec(-2.0_f32..2.0, 4),
        per_frame in 1_i64..12,
        rule in prop_oneof![Just(Accumulation::Mean), Just(Accumulation::Sum)],
    ) {
        let dimension = Dimension {
            name: "elbow".into(),
            unit: "rad/s".into(),
            kind: Kind::JointVelocity,
            offset: 0.0,
            scale: 0.5,
            clip: 10.0,
        };
        let space = ActionSpace::new("elbow".into(), 5.0, vec![dimension]).unwrap();
        let mut motion = motion();
        for (index, frame) in (0..).zip(&frames) {
            for tick in 0..per_frame {
                motion.take(START + index * FRAME + tick * FRAME / per_frame, [*frame].into());
            }
        }
        motion.take(START + 4 * FRAME, [0.0].into());
        let way = frames.iter().map(|velocity| velocity * 0.2).sum::<f32>();
        let whole = motion.between(&space, START, START + 4 * FRAME).unwrap();
        prop_assert!((whole.values[0] * 0.8 - way).abs() < 1e-5);
        // A model step of four intervals keeps the integral under both rules, and decodes back.
        let encoding = ActionEncoding::new(space, 1, 4, rule).unwrap();
        let step = motion.step(&encoding, START, START + 4 * FRAME).unwrap();
        prop_assert!((step.model.values[0] / 0.5 * 0.8 - way).abs() < 1e-5);
        let back = encoding.decode_step(&step.model.values).unwrap();
        prop_assert!((back[0] * 0.8 - way).abs() < 1e-5);
    }
}

#[test]
fn velocity_holds_for_the_longest_time_only() {
    let dimension = Dimension {
        name: "dx".into(),
        unit: "m/s".into(),
        kind: Kind::Velocity,
        offset: 0.0,
        scale: 1.0,
        clip: 1.0,
    };
    let space = ActionSpace::new("base".into(), 5.0, vec![dimension]).unwrap();
    let mut motion = motion();
    motion.take(START, [0.5].into());
    motion.take(START + 100 * FRAME, [0.0].into());
    let mean = |from: i64, to: i64| {
        let interval = motion.between(&space, START + from * FRAME, START + to * FRAME);
        interval.unwrap().values[0]
    };
    // 1 s of 4 s at 0.5 m/s.
    assert_eq!(mean(0, 20), 0.125);
    assert_eq!(mean(50, 51), 0.0);
}

proptest! {
    /// A model knows no durations: a constant velocity over a longer step is a larger motion, as with deltas.
    #[test]
    fn velocity_over_a_longer_step_is_more_motion(
        speed in -1.0_f32..1.0, percent in 30_i64..300, skip in 1_usize..4,
        rule in prop_oneof![Just(Accumulation::Mean), Just(Accumulation::Sum)],
    ) {
        let dimension = |name: &str, kind, scale| Dimension {
            name: name.into(),
            unit: "rad".into(),
            kind,
            offset: 0.0,
            scale,
            clip: 10.0,
        };
        let space = ActionSpace::new("joints".into(), 5.0, vec![
            dimension("velocity", Kind::JointVelocity, 1.0),
            // The motion in 0.2 s.
            dimension("delta", Kind::JointDelta, 5.0),
        ]).unwrap();
        let mut motion = motion();
        for tick in 0..100 {
            motion.take(START + tick * FRAME / 5, [speed, speed * 0.04].into());
        }
        let encoding = ActionEncoding::new(space, 2, skip, rule).unwrap();
        let nominal_ns = skip as i64 * FRAME;
        let of = |span_ns| motion.step(&encoding, START, START + span_ns).unwrap().model.values;
        let (nominal, found) = (of(nominal_ns), of(nominal_ns * percent / 100));
        let expected = speed * percent as f32 / 100.0;
        prop_assert!((nominal[0] - speed).abs() < 1e-5, "{:?}", nominal);
        prop_assert!((found[0] - expected).abs() < 1e-4, "{:?} {}", found, expected);
        let intervals = if rule == Accumulation::Sum { skip as f32 } else { 1.0 };
        prop_assert!((found[1] - expected * intervals).abs() < 1e-3, "{:?} {}", found, expected);
    }
}
