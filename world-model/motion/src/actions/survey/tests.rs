#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use super::*;

const NO_STATES: &[[f32; 7]] = &[];

/// A moving pose whose gripper closes halfway.
fn poses(count: usize) -> Vec<[f32; 7]> {
    let pose = |step: usize| {
        let phase = step as f32;
        let gripper = f32::from(step < count / 2);
        [
            0.3 + 0.05 * (phase * 0.9).sin(),
            0.1,
            0.2 + 0.03 * (phase * 0.5).cos(),
            3.1,
            0.0,
            0.2,
            gripper,
        ]
    };
    (0..count).map(pose).collect()
}

/// The changes from each pose to the next.
fn deltas(poses: &[[f32; 7]]) -> Vec<[f32; 7]> {
    let mut deltas: Vec<[f32; 7]> = poses
        .windows(2)
        .map(|pair| {
            let mut delta = [0.0; 7];
            for index in 0..6 {
                delta[index] = pair[1][index] - pair[0][index];
            }
            delta[6] = pair[1][6];
            delta
        })
        .collect();
    deltas.push([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, poses[poses.len() - 1][6]]);
    deltas
}

fn survey_of(actions: &[[f32; 7]], states: &[[f32; 7]]) -> ActionSurvey {
    let mut survey = ActionSurvey::new(ActionSpace::bridge(), 5.0);
    survey.add(actions, states);
    survey
}

#[test]
fn deltas_of_real_motion_have_no_contradictions() {
    let poses = poses(40);
    let survey = survey_of(&deltas(&poses), &poses);
    assert_eq!(survey.contradictions(), []);
    assert_eq!(survey.hints(), []);
    let text = survey.to_string();
    assert!(
        text.starts_with("actions of 1 episode at 5 Hz: dx -0.0"),
        "{text}"
    );
    assert!(text.ends_with("gripper 0 to 1"), "{text}");
}

#[test]
fn absolute_poses_are_recognised() {
    let poses = poses(40);
    for states in [NO_STATES, &poses] {
        let found = survey_of(&poses, states).contradictions();
        assert_eq!(found[0].cause, Cause::Absolute, "{found:?}");
        let text = found[0].to_string();
        assert!(
            text.contains("dx: measured 0.251 to 0.349 m") && text.contains("absolute positions"),
            "{text}"
        );
    }
    // Near the base's origin, only states reveal it.
    let near: Vec<[f32; 7]> = poses
        .iter()
        .map(|pose| {
            let mut pose = *pose;
            pose[0] -= 0.3;
            pose[1] = 0.0;
            pose[2] = 0.02;
            pose[3] = 0.0;
            pose
        })
        .collect();
    let found = survey_of(&near, &near).contradictions();
    assert!(
        found.is_empty() || found[0].cause == Cause::Absolute,
        "{found:?}"
    );
}

#[test]
fn unusual_gripper_range_is_named() {
    for (values, closed, open) in [
        (vec![-1.0, 0.0, 1.0], -1.0, 1.0),
        (vec![0.0, 30.0, 60.0], 0.0, 100.0),
        (vec![0.0, 180.0], 0.0, 255.0),
        (vec![0.0, 1.57], 0.0, 1.57),
        (vec![-0.5, 3.0], -0.5, 3.0),
    ] {
        let actions: Vec<[f32; 7]> = values
            .iter()
            .map(|v| [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, *v])
            .collect();
        let found = survey_of(&actions, NO_STATES).contradictions();
        assert_eq!(found.len(), 1, "{values:?}");
        assert_eq!(
            found[0].cause,
            Cause::Gripper { closed, open },
            "{values:?}"
        );
        assert!(
            found[0]
                .to_string()
                .contains("expected 0 (closed) to 1 (open)")
        );
    }
}

#[test]
fn unusual_grippers_are_hints() {
    let with = |grippers: &[f32]| {
        let actions: Vec<[f32; 7]> = grippers
            .iter()
            .map(|v| [0.001, 0.0, 0.0, 0.0, 0.0, 0.0, *v])
            .collect();
        let survey = survey_of(&actions, NO_STATES);
        assert_eq!(survey.contradictions(), []);
        survey.hints()
    };
    assert_eq!(with(&[1.0, 1.0, 0.0, 1.0]), []);
    assert_eq!(with(&[1.0; 4]), []);
    assert!(matches!(
        with(&[0.8, 0.8, 0.0])[..],
        [Hint::GripperRange { .. }]
    ));
    assert!(matches!(
        with(&[0.0, 1.0, 1.0])[..],
        [Hint::GripperInverted {
            begin_closed: 1,
            episodes: 1,
            ..
        }]
    ));
}

#[test]
fn wrong_units_and_jumps_are_recognised() {
    let along = |values: &[f32], index: usize| {
        let rows: Vec<[f32; 7]> = values
            .iter()
            .map(|value| {
                let mut row = [0.0; 7];
                row[index] = *value;
                row
            })
            .collect();
        let found = survey_of(&rows, NO_STATES).contradictions();
        found.first().map(|found| found.cause)
    };
    assert_eq!(along(&[0.6, -0.6, 0.6], 0), Some(Cause::Normalised));
    assert_eq!(along(&[3.0, -2.0, 3.0], 0), Some(Cause::TooFar));
    assert_eq!(along(&[12.0, -30.0, 0.0], 1), Some(Cause::Millimetres));
    assert_eq!(along(&[25.0, -30.0, 5.0], 4), Some(Cause::Degrees));
    assert_eq!(along(&[0.05, -0.3, 0.0], 0), None);
}

#[test]
fn lag_and_scale_are_hints() {
    let poses = poses(60);
    let actions = deltas(&poses);
    let mut late = actions.clone();
    late.rotate_right(1);
    late[0] = [0.0; 7];
    let hints = survey_of(&late, &poses).hints();
    assert!(hints.contains(&Hint::Lag { frames: -1 }), "{hints:?}");
    assert!(
        hints.contains(&Hint::FirstZero {
            zero: 1,
            episodes: 1
        }),
        "{hints:?}"
    );
    // 5 Hz: a velocity is five times the delta.
    let fast: Vec<[f32; 7]> = actions
        .iter()
        .map(|action| {
            let mut action = *action;
            action[..6].iter_mut().for_each(|value| *value *= 5.0);
            action
        })
        .collect();
    let hints = survey_of(&fast, &poses).hints();
    assert!(
        matches!(&hints[..], [Hint::Scale { column, factor }, ..] if column == "dx" && (factor - 0.2).abs() < 1e-3),
        "{hints:?}"
    );
}

#[test]
fn joint_kinds_have_their_own_ranges() {
    let of = |kind, unit: &str, values: &[f32]| {
        let dimension = Dimension {
            name: "elbow".into(),
            unit: unit.into(),
            kind,
            offset: 0.0,
            scale: 1.0,
            clip: 1.0,
        };
        let space = ActionSpace::new("arm".into(), 10.0, vec![dimension]).unwrap();
        let mut survey = ActionSurvey::new(space, 10.0);
        let rows: Vec<[f32; 1]> = values.iter().map(|value| [*value]).collect();
        survey.add(&rows, NO_STATES);
        survey.contradictions().first().map(|found| found.cause)
    };
    assert_eq!(of(Kind::JointPosition, "rad", &[-3.0, 3.0]), None);
    assert_eq!(
        of(Kind::JointPosition, "rad", &[-60.0, 150.0]),
        Some(Cause::Degrees)
    );
    assert_eq!(of(Kind::JointPosition, "deg", &[-60.0, 150.0]), None);
    assert_eq!(of(Kind::JointVelocity, "rad/s", &[-1.1, 0.9]), None);
    assert_eq!(
        of(Kind::JointVelocity, "rad/s", &[-40.0, 30.0]),
        Some(Cause::Degrees)
    );
    assert_eq!(
        of(Kind::JointDelta, "rad", &[1.5, 1.51, 1.52]),
        Some(Cause::Absolute)
    );
    assert_eq!(
        of(Kind::JointDelta, "rad", &[0.05; 300]),
        Some(Cause::Absolute)
    );
    assert_eq!(of(Kind::JointPosition, "ticks", &[900.0]), None);
}
