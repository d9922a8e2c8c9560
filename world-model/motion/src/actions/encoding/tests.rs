#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use super::*;
use proptest::prelude::*;

const OPEN: [f32; 7] = [0.01, -0.02, 0.005, 0.1, -0.05, 0.0, 1.0];
const CLOSED: [f32; 7] = [0.03, 0.0, 0.005, 0.1, 0.05, 0.0, 0.0];

fn with(accumulation: Accumulation) -> ActionEncoding {
    ActionEncoding::new(ActionSpace::bridge(), 10, 2, accumulation).unwrap()
}

#[test]
fn scales_match_the_authors_release() {
    let scaled = ActionEncoding::default().scale(&OPEN).unwrap();
    let expected = [0.35, -0.7, 0.175, 0.56, -0.28, 0.0, -1.0];
    for (value, expected) in scaled.values.iter().zip(expected) {
        assert!((value - expected).abs() < 1e-6, "{scaled:?}");
    }
    assert_eq!(scaled.clipped, 0);
}

#[test]
fn intervals_are_clipped_before_the_mean() {
    let mut far = CLOSED;
    far[0] = 1.0;
    far[3] = -1.0;
    let step = ActionEncoding::default().encode_step(&[far, OPEN]).unwrap();
    assert!((step.values[0] - (1.74 + 0.35) / 2.0).abs() < 1e-6);
    assert!((step.values[3] - (-1.39 + 0.56) / 2.0).abs() < 1e-6);
    assert_eq!(step.values[6], -1.0, "the gripper of the last interval");
    assert_eq!(step.clipped, 2);
}

#[test]
fn index_rule_uses_the_first_interval() {
    let encoding = with(Accumulation::Index);
    let step = encoding.encode_step(&[CLOSED, OPEN]).unwrap().values;
    assert_eq!(step[..7], encoding.scale(&CLOSED).unwrap().values);
    assert_eq!(step[7..], [0.0; 3]);
}

#[test]
fn sum_rule_adds_intervals() {
    let step = with(Accumulation::Sum)
        .encode_step(&[CLOSED, OPEN])
        .unwrap();
    assert!((step.values[0] - 35.0 * 0.04).abs() < 1e-6);
    assert_eq!(step.values[6], -1.0);
}

#[test]
fn half_open_counts_as_closed() {
    let mut half = OPEN;
    half[6] = 0.5;
    assert_eq!(
        ActionEncoding::default().scale(&half).unwrap().values[6],
        1.0
    );
}

#[test]
fn invalid_input_is_rejected_by_name() {
    let encoding = ActionEncoding::default();
    let error = encoding
        .encode_step(&[[0.0; 6]; 2])
        .unwrap_err()
        .to_string();
    assert!(error.contains("6 values; expected 7"), "{error}");
    let mut bad = OPEN;
    bad[4] = f32::INFINITY;
    let not_finite = ActionError::NotFinite {
        index: 4,
        value: f32::INFINITY,
    };
    assert_eq!(encoding.encode_step(&[OPEN, bad]), Err(not_finite));
    for actual in [0, 1, 3] {
        let error = encoding.encode_step(&vec![OPEN; actual]);
        assert_eq!(
            error,
            Err(ActionError::Count {
                expected: 2,
                actual
            })
        );
    }
    assert!(encoding.decode_step(&[0.0; 8]).is_err());
    let none = ActionEncoding::new(ActionSpace::bridge(), 7, 0, Accumulation::Mean);
    assert!(none.unwrap_err().to_string().contains("frame_skip is 0"));
    let narrow = ActionEncoding::new(ActionSpace::bridge(), 6, 2, Accumulation::Mean);
    assert!(narrow.unwrap_err().to_string().contains("action_dim is 6"));
}

#[test]
fn files_older_than_action_spaces_are_read() {
    let text = r#"{"action_dim": 10, "frame_skip": 2, "accumulation": "mean", "translation_scale": 40.0,
                   "translation_clip": 1.74, "rotation_scale": 5.6, "rotation_clip": 1.39}"#;
    let encoding: ActionEncoding = serde_json::from_str(text).unwrap();
    assert_eq!(encoding.space().dimensions()[0].scale, 40.0);
    assert_eq!((encoding.action_dim(), encoding.space().len()), (10, 7));
    let again = serde_json::to_string(&encoding).unwrap();
    assert_eq!(
        serde_json::from_str::<ActionEncoding>(&again).unwrap(),
        encoding
    );
    for (text, named) in [
        (r#"{"translation_scale": 0.0}"#, "dx: scale"),
        (r#"{"frame_skip": 0}"#, "frame_skip is 0"),
        (r#"{"frame_skipp": 1}"#, "frame_skipp"),
    ] {
        let error = serde_json::from_str::<ActionEncoding>(text)
            .unwrap_err()
            .to_string();
        assert!(error.contains(named), "{error}");
    }
}

fn rules() -> impl Strategy<Value = Accumulation> {
    prop_oneof![
        Just(Accumulation::Mean),
        Just(Accumulation::Sum),
        Just(Accumulation::Index)
    ]
}

proptest! {
    #[test]
    fn encoding_inverts_decoding_within_clips(
        translation in prop::array::uniform3(-0.049_f32..0.049),
        rotation in prop::array::uniform3(-0.24_f32..0.24),
        open in any::<bool>(),
        skip in 1_usize..4,
        rule in rules(),
    ) {
        let encoding = ActionEncoding::new(ActionSpace::bridge(), 10, skip, rule).unwrap();
        let mut action = [0.0; 7];
        action[..3].copy_from_slice(&translation);
        action[3..6].copy_from_slice(&rotation);
        action[6] = f32::from(open);
        let model = encoding.encode_step(&vec![action; skip]).unwrap();
        prop_assert_eq!(model.clipped, 0);
        for (value, (low, high)) in model.values.iter().zip(encoding.bounds()) {
            prop_assert!((low..=high).contains(value));
        }
        let whole = encoding.decode_step(&model.values).unwrap();
        for index in 0..3 {
            // Four roundings of f32 on values below 0.25 x 3.
            prop_assert!((whole[index] - action[index] * skip as f32).abs() < 1e-6);
        }
        let composed = rotation::multiple([action[3], action[4], action[5]], skip as f64);
        for (found, expected) in whole[3..6].iter().zip(composed) {
            prop_assert!((found - expected).abs() < 1e-6);
        }
        prop_assert_eq!(whole[6], action[6]);
    }
}
