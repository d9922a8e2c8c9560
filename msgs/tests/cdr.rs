//! Property tests of the CDR codec: round trips of every shape of field, and arbitrary bytes.

use proptest::prelude::*;
use wm_msgs::{
    builtin_interfaces::{Duration, Time},
    cdr::{self, CdrError},
    diagnostic_msgs::DiagnosticArray,
    sensor_msgs::Image,
    std_msgs::{Header, String as Text},
    wm_msgs::{Action, ActionChunk, Latent, LatentSpace, Plan, Prediction, ResetRequest},
};

fn header() -> impl Strategy<Value = Header> {
    (any::<i32>(), 0u32..1_000_000_000, ".{0,12}").prop_map(|(sec, nanosec, frame_id)| Header {
        stamp: Time { sec, nanosec },
        frame_id,
    })
}

fn action() -> impl Strategy<Value = Action> {
    (header(), prop::collection::vec(-10f32..10.0, 0..9))
        .prop_map(|(header, values)| Action { header, values })
}

fn latent() -> impl Strategy<Value = Latent> {
    (
        header(),
        "[a-z+]{0,9}",
        "[0-9a-f]{0,64}",
        any::<u64>(),
        prop::collection::vec(any::<u8>(), 0..300),
    )
        .prop_map(|(header, name, hash, epoch, data)| Latent {
            header,
            space: LatentSpace { name, hash },
            height: 1,
            width: 2,
            channels: 3,
            dtype: Latent::BF16,
            epoch,
            change: 0.25,
            frozen: true,
            data,
        })
}

fn prediction() -> impl Strategy<Value = Prediction> {
    (
        header(),
        latent(),
        prop::collection::vec(action(), 0..4),
        any::<u64>(),
        any::<u32>(),
        ".{0,9}",
    )
        .prop_map(|(header, latent, actions, seed, step, model)| Prediction {
            observed_stamp: header.stamp,
            received_stamp: Time {
                sec: -1,
                nanosec: 1,
            },
            ready_stamp: Time { sec: 1, nanosec: 2 },
            header,
            step,
            horizon: 8,
            step_period: Duration::from_nanos(400_000_000),
            epoch: latent.epoch,
            latent,
            actions,
            model_hash: model.clone(),
            model,
            seed,
            integration_steps: 4,
        })
}

#[test]
fn bytes_follow_the_standard() {
    let text = Text { data: "ab".into() };
    assert_eq!(
        cdr::to_bytes(&text).unwrap(),
        [0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0]
    );
    // alignment is counted from the end of the header
    let request = ResetRequest {
        seed: 1,
        keep_seed: true,
    };
    assert_eq!(
        cdr::to_bytes(&request).unwrap(),
        [0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1]
    );
    assert_eq!(
        cdr::from_bytes::<Text>(&[0, 0, 0, 0, 0, 0, 0, 3, b'a', b'b', 0]).unwrap(),
        text
    );
}

#[test]
fn errors_name_the_found_bytes() {
    let error = |bytes: &[u8]| cdr::from_bytes::<Text>(bytes).unwrap_err();
    assert!(matches!(error(&[0, 1, 0]), CdrError::NoHeader(3)));
    assert!(matches!(
        error(&[0, 3, 0, 0]),
        CdrError::Representation(0, 3)
    ));
    assert!(matches!(
        error(&[0, 1, 0, 0, 255, 255, 255, 255]),
        CdrError::Decode { len: 8, .. }
    ));
    let mut long = cdr::to_bytes(&Text { data: "ab".into() }).unwrap();
    long.extend([0; 4]);
    assert!(matches!(
        error(&long),
        CdrError::Trailing {
            used: 11,
            len: 15,
            ..
        }
    ));
}

proptest! {
    #[test]
    fn predictions_survive_encoding(prediction in prediction()) {
        let bytes = cdr::to_bytes(&prediction).unwrap();
        prop_assert_eq!(cdr::from_bytes::<Prediction>(&bytes).unwrap(), prediction);
    }

    #[test]
    fn chunks_survive_padding(header in header(), actions in prop::collection::vec(action(), 0..9), padding in 0usize..4) {
        let chunk = ActionChunk { header, period: Duration::from_nanos(200_000_000), actions, ..ActionChunk::default() };
        let mut bytes = cdr::to_bytes(&chunk).unwrap();
        bytes.extend(vec![0; padding]);
        prop_assert_eq!(cdr::from_bytes::<ActionChunk>(&bytes).unwrap(), chunk);
    }

    /// Every proper prefix ends inside a field, so it must be refused.
    #[test]
    fn truncated_messages_are_refused(prediction in prediction(), cut in any::<prop::sample::Index>()) {
        let bytes = cdr::to_bytes(&prediction).unwrap();
        prop_assert!(cdr::from_bytes::<Prediction>(&bytes[..cut.index(bytes.len())]).is_err());
    }

    /// Any bytes give a value or an error, never a panic. Half of the headers are valid.
    #[test]
    fn any_bytes_give_a_message_or_an_error(mut bytes in prop::collection::vec(any::<u8>(), 0..200), valid in any::<bool>()) {
        if valid && bytes.len() >= 4 {
            bytes[..4].copy_from_slice(&[0, 1, 0, 0]);
        }
        if let Ok(plan) = cdr::from_bytes::<Plan>(&bytes) {
            prop_assert!(cdr::to_bytes(&plan).is_ok());
        }
        cdr::from_bytes::<Image>(&bytes).ok();
        cdr::from_bytes::<DiagnosticArray>(&bytes).ok();
        cdr::from_bytes::<Prediction>(&bytes).ok();
    }
}
