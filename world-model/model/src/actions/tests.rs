#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use super::*;
use proptest::prelude::*;

const OPEN: [f32; 7] = [0.01, -0.02, 0.005, 0.1, -0.05, 0.0, 1.0];
const CLOSED: [f32; 7] = [0.03, 0.0, 0.005, 0.1, 0.05, 0.0, 0.0];

#[test]
fn scales_as_the_reference_does() {
    let scaled = ActionEncoding::default().scale(&OPEN).unwrap();
    let expected = [0.35, -0.7, 0.175, 0.56, -0.28, 0.0, -1.0];
    for (value, expected) in scaled.iter().zip(expected) {
        assert!((value - expected).abs() < 1e-6, "{scaled:?}");
    }
}

#[test]
fn clips_each_action_before_the_mean() {
    let mut far = CLOSED;
    far[0] = 1.0;
    far[3] = -1.0;
    let encoding = ActionEncoding::default();
    let step = encoding.encode_step(&[far, OPEN]).unwrap();
    assert!((step[0] - (1.74 + 0.35) / 2.0).abs() < 1e-6);
    assert!((step[3] - (-1.39 + 0.56) / 2.0).abs() < 1e-6);
    assert_eq!(step[6], -1.0, "the gripper of the last action");
}

#[test]
fn index_rule_takes_the_sampled_frame_only() {
    let encoding = ActionEncoding {
        accumulation: Accumulation::Index,
        action_dim: 10,
        ..Default::default()
    };
    let step = encoding.encode_step(&[CLOSED, OPEN]).unwrap();
    assert_eq!(step[..7], encoding.scale(&CLOSED).unwrap());
    assert_eq!(step[7..], [0.0; 3]);
}

#[test]
fn half_open_counts_as_closed() {
    let mut half = OPEN;
    half[6] = 0.5;
    assert_eq!(ActionEncoding::default().scale(&half).unwrap()[6], 1.0);
}

#[test]
fn refuses_by_name() {
    let encoding = ActionEncoding::default();
    assert_eq!(
        encoding.scale(&[0.0; 6]),
        Err(ActionError::Length {
            expected: 7,
            actual: 6
        })
    );
    let mut bad = OPEN;
    bad[4] = f32::INFINITY;
    assert_eq!(
        encoding.scale(&bad),
        Err(ActionError::NotFinite {
            index: 4,
            value: f32::INFINITY
        })
    );
    assert_eq!(
        encoding.encode_step(&[OPEN]),
        Err(ActionError::Count {
            expected: 2,
            actual: 1
        })
    );
    assert_eq!(
        encoding.encode_step::<[f32; 7]>(&[]),
        Err(ActionError::Count {
            expected: 2,
            actual: 0
        })
    );
    assert!(encoding.decode_step(&[0.0; 8]).is_err());
    assert!(
        ActionEncoding {
            frame_skip: 0,
            ..encoding.clone()
        }
        .validate()
        .is_err()
    );
    assert!(
        ActionEncoding {
            translation_scale: f32::NAN,
            ..encoding
        }
        .validate()
        .is_err()
    );
}

#[test]
fn a_remainder_is_left_out() {
    assert_eq!(
        ActionEncoding::default()
            .encode_steps(&[OPEN; 5])
            .unwrap()
            .len(),
        2
    );
}

proptest! {
    /// A step of equal actions within the clips decodes to their sum, and stays within the bounds.
    #[test]
    fn decoding_inverts_encoding(
        translation in prop::array::uniform3(-0.049_f32..0.049),
        rotation in prop::array::uniform3(-0.24_f32..0.24),
        open in any::<bool>(),
        skip in 1_usize..4,
    ) {
        let encoding = ActionEncoding { frame_skip: skip, action_dim: 10, ..Default::default() };
        let mut action = [0.0; 7];
        action[..3].copy_from_slice(&translation);
        action[3..6].copy_from_slice(&rotation);
        action[6] = f32::from(open);
        let model = encoding.encode_step(&vec![action; skip]).unwrap();
        for (value, (low, high)) in model.iter().zip(encoding.bounds()) {
            prop_assert!((low..=high).contains(value));
        }
        let delta = encoding.decode_step(&model).unwrap();
        for index in 0..6 {
            // Four roundings of f32 on values below 0.25 x 3.
            prop_assert!((delta[index] - action[index] * skip as f32).abs() < 1e-6);
        }
        prop_assert_eq!(delta[6], action[6]);
    }
}
