#![allow(clippy::unwrap_used)]

use super::*;

const RATE: f64 = 10.0;

/// Joint velocities that change every half a second \[rad/s\], different for each seed.
fn velocities(seed: u64, frames: usize) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut now = 0.0;
    let next = |frame| {
        if frame % 5 == 0 {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            now = (state >> 40) as f64 / f64::from(1 << 23) - 1.0;
        }
        now
    };
    (0..frames).map(next).collect()
}

/// The positions that velocities reach, from `start` on.
fn positions(velocities: &[f64], start: f64) -> Vec<f64> {
    let sum = |now: &mut f64, velocity: &f64| {
        let here = *now;
        *now += velocity / RATE;
        Some(here)
    };
    velocities.iter().scan(start, sum).collect()
}

/// Named columns.
type Columns = Vec<(&'static str, Vec<f64>)>;

fn derive_with(actions: &Columns, states: &Columns, gripper: Option<&str>) -> DerivedSpace {
    let names = |columns: &Columns| columns.iter().map(|(name, _)| (*name).to_owned()).collect();
    let row = |columns: &Columns, at: usize| columns.iter().map(|(_, values)| values[at]).collect();
    let frames = actions[0].1.len();
    let single = |row: Vec<f64>| row.into_iter().map(|value| value as f32).collect();
    let actions_of = (0..frames).map(|at| single(row(actions, at))).collect();
    let states_of = (0..frames).map(|at| row(states, at)).collect();
    let description = Description {
        robot: "arm".to_owned(),
        names: names(actions),
        states: names(states),
        rate: RATE,
    };
    let mapping = ActionMapping {
        gripper: gripper.map(|range| range.parse().unwrap()),
        ..ActionMapping::default()
    };
    let episodes = std::iter::once((actions_of, states_of));
    DerivedSpace::derive(description, mapping, episodes)
        .unwrap()
        .unwrap()
}

fn derive(actions: &Columns, states: &Columns) -> DerivedSpace {
    derive_with(actions, states, None)
}

/// Kind and unit of each value.
fn kinds(derived: &DerivedSpace) -> Vec<(Kind, &str)> {
    let dimensions = derived.space.dimensions().iter();
    dimensions.map(|d| (d.kind, d.unit.as_str())).collect()
}

fn scaled(values: &[f64], factor: f64) -> Vec<f64> {
    values.iter().map(|value| value * factor).collect()
}

const FRAMES: usize = 300;

#[test]
fn velocities_are_found_by_name_and_by_value() {
    let (a, b) = (velocities(1, FRAMES), velocities(2, FRAMES));
    let still = vec![0.0; FRAMES];
    let states = vec![
        ("joint_0", positions(&a, 0.3)),
        ("joint_1", positions(&b, -1.0)),
        ("joint_2", vec![0.5; FRAMES]),
    ];
    let velocity = (Kind::JointVelocity, "rad/s");
    for names in [
        ["joint_0_vel", "joint_1_vel", "joint_2_vel"],
        ["joint_0", "joint_1", "joint_2"],
        ["value_0", "value_1", "value_2"],
    ] {
        let [first, second, third] = names;
        let actions = vec![
            (first, a.clone()),
            (second, b.clone()),
            (third, still.clone()),
        ];
        let derived = derive(&actions, &states);
        assert_eq!(kinds(&derived), [velocity; 3], "{names:?}\n{derived}");
        let dimensions = derived.space.dimensions();
        assert!(
            dimensions[0].scale > 1.0 && dimensions[0].scale < 1.4,
            "{derived}"
        );
        assert_eq!((dimensions[0].clip, derived.space.rate()), (1.5, RATE));
        assert_eq!(dimensions[0].name, first);
    }
    // Names alone, without a recorded state.
    let actions = vec![("qd1", a.clone()), ("j2_velocity", b.clone())];
    assert_eq!(kinds(&derive(&actions, &vec![])), [velocity; 2]);
}

#[test]
fn deltas_and_targets_are_found_by_value() {
    let (a, b) = (velocities(3, FRAMES), velocities(4, FRAMES));
    let (at_a, at_b) = (positions(&a, 0.3), positions(&b, -1.0));
    let states = vec![("shoulder", at_a.clone()), ("elbow", at_b.clone())];
    let deltas = vec![
        ("shoulder", scaled(&a, 1.0 / RATE)),
        ("elbow", scaled(&b, 1.0 / RATE)),
    ];
    let derived = derive(&deltas, &states);
    assert_eq!(kinds(&derived), [(Kind::JointDelta, "rad"); 2], "{derived}");
    // Targets two frames ahead.
    let ahead = |values: &[f64]| {
        let last = values.last().copied();
        let later = values.iter().skip(2).copied().chain(last).chain(last);
        later.collect::<Vec<f64>>()
    };
    for names in [
        ["shoulder", "elbow"],
        ["shoulder.target", "elbow.target"],
        ["m1", "m2"],
    ] {
        let [first, second] = names;
        let targets = vec![(first, ahead(&at_a)), (second, ahead(&at_b))];
        let derived = derive(&targets, &states);
        assert_eq!(
            kinds(&derived),
            [(Kind::JointPosition, "rad"); 2],
            "{names:?}\n{derived}"
        );
    }
    // A target that never moves has the name of a state.
    let states = vec![("elbow", vec![1.2; FRAMES])];
    let derived = derive(&vec![("elbow", vec![1.2; FRAMES])], &states);
    assert_eq!(kinds(&derived), [(Kind::JointPosition, "rad")]);
    let elbow = &derived.space.dimensions()[0];
    assert_eq!((elbow.offset, elbow.scale), (1.2, 1.0));
}

#[test]
fn fingers_hands_and_degrees_have_their_kinds() {
    let a = velocities(5, FRAMES);
    let at = positions(&a, 0.5);
    let unit = scaled(&at, 0.3);
    for (name, values, expected) in [
        ("kRightHandPinky", unit.clone(), (Kind::Position, "1")),
        ("ee_x", unit.clone(), (Kind::Position, "m")),
        ("tcp_yaw", at.clone(), (Kind::Orientation, "rad")),
        ("elbow_deg", scaled(&at, 50.0), (Kind::JointPosition, "deg")),
        ("elbow", scaled(&at, 50.0), (Kind::JointPosition, "1")),
        ("vx", scaled(&a, 0.1), (Kind::Velocity, "m/s")),
        ("dx", scaled(&a, 0.01), (Kind::JointDelta, "m")),
    ] {
        let state = match expected.0 {
            Kind::Position | Kind::Orientation | Kind::JointPosition => values.clone(),
            _ => vec![],
        };
        let states = match state.is_empty() {
            true => vec![],
            false => vec![(name, state)],
        };
        let derived = derive(&vec![(name, values)], &states);
        assert_eq!(kinds(&derived), [expected], "{derived}");
    }
}

#[test]
fn grippers_are_binary_or_have_their_measured_range() {
    let halves = |low: f64, high: f64| -> Vec<f64> {
        let at = |frame| if frame % 60 < 30 { low } else { high };
        (0..FRAMES).map(at).collect()
    };
    let of = |values: Vec<f64>, range| {
        let derived = derive_with(&vec![("gripper", values)], &vec![], range);
        let gripper = derived.space.dimensions()[0].clone();
        let open = gripper.offset + gripper.scale.recip();
        (gripper.kind, gripper.offset, open)
    };
    assert_eq!(of(halves(0.0, 1.0), None), (Kind::GripperBinary, 0.0, 1.0));
    let continuous = Kind::GripperContinuous;
    assert_eq!(of(halves(-1.0, 1.0), None), (continuous, -1.0, 1.0));
    let (kind, closed, open) = of(halves(0.0, 80.0), None);
    assert!(kind == continuous && closed == 0.0 && (open - 80.0).abs() < 1e-4);
    // The values are mapped first.
    assert_eq!(
        of(halves(80.0, 0.0), Some("80:0")),
        (Kind::GripperBinary, 0.0, 1.0)
    );
}

#[test]
fn unknown_values_are_positions_without_a_unit() {
    let (a, b) = (velocities(6, FRAMES), velocities(7, FRAMES));
    let derived = derive(
        &vec![("knob", a.clone())],
        &vec![("lamp", positions(&b, 0.0))],
    );
    assert_eq!(kinds(&derived), [(Kind::Position, "1")], "{derived}");
    // Deltas by name, whose sum leaves any reach, are none.
    let derived = derive(&vec![("dx", positions(&scaled(&a, 0.2), 0.4))], &vec![]);
    assert_eq!(kinds(&derived), [(Kind::Position, "1")], "{derived}");
}

#[test]
fn velocities_in_unknown_units_have_no_unit() {
    let a = velocities(8, FRAMES);
    let states = vec![("joint", positions(&a, 0.0))];
    let derived = derive(&vec![("joint_vel", scaled(&a, 9.0))], &states);
    assert_eq!(kinds(&derived), [(Kind::JointVelocity, "1")], "{derived}");
    assert!(derived.to_string().contains("unknown unit"), "{derived}");
    let derived = derive(&vec![("joint_vel", scaled(&a, 60.0))], &vec![]);
    assert_eq!(kinds(&derived), [(Kind::JointVelocity, "1")], "{derived}");
}

#[test]
fn values_of_one_kind_share_an_unknown_unit() {
    let (a, b) = (velocities(11, FRAMES), velocities(12, FRAMES));
    let wide = scaled(&positions(&a, 0.0), 60.0);
    let narrow = positions(&b, 0.0);
    let columns = vec![("pan", wide), ("roll_joint", narrow)];
    let derived = derive(&columns, &columns);
    assert_eq!(
        kinds(&derived),
        [(Kind::JointPosition, "1"); 2],
        "{derived}"
    );
    assert!(derived.to_string().contains("12.6 rad"), "{derived}");
}

#[test]
fn names_that_no_space_may_have_are_replaced() {
    let a = velocities(9, FRAMES);
    let long: &'static str =
        "a_very_long_name_of_a_value_that_no_action_space_may_have_at_all_really";
    let actions = vec![
        ("q", a.clone()),
        ("q", a.clone()),
        ("", a.clone()),
        (long, a),
    ];
    let derived = derive(&actions, &vec![]);
    let names: Vec<&str> = derived
        .space
        .dimensions()
        .iter()
        .map(|d| d.name.as_str())
        .collect();
    let expected = ["q", "value_1_of_action", "value_2_of_action"];
    assert_eq!(names[..3], expected);
    assert!(long.starts_with(names[3]) && names[3].len() == 64);
}

#[test]
fn episodes_that_are_not_finite_are_no_evidence() {
    let a = velocities(10, FRAMES);
    let mut bad = a.clone();
    bad[7] = f64::NAN;
    let description = || Description {
        robot: "arm".to_owned(),
        names: vec!["j_vel".to_owned()],
        states: vec![],
        rate: RATE,
    };
    let episode = |values: &[f64]| -> Values {
        (
            values.iter().map(|value| vec![*value as f32]).collect(),
            vec![],
        )
    };
    let derive = |episodes: Vec<Values>| {
        DerivedSpace::derive(
            description(),
            ActionMapping::default(),
            episodes.into_iter(),
        )
        .unwrap()
    };
    let both = derive(vec![episode(&bad), episode(&a)]).unwrap();
    assert_eq!(both.space, derive(vec![episode(&a)]).unwrap().space);
    assert!(derive(vec![episode(&bad)]).is_none());
    assert!(derive(vec![]).is_none());
}
