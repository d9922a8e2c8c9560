use proptest::prelude::*;

use super::*;
use crate::{gradient_tree::covering, processes::message::EndState};

fn values(sizes: Vec<usize>) -> impl Strategy<Value = Vec<Vec<f32>>> {
    let value = any::<u32>().prop_map(f32::from_bits);
    let values: Vec<_> = (sizes.into_iter())
        .map(|size| proptest::collection::vec(value.clone(), size))
        .collect();
    values
}

fn bits(values: &[Vec<f32>]) -> Vec<Vec<u32>> {
    let bits = |values: &Vec<f32>| values.iter().map(|value| value.to_bits()).collect();
    values.iter().map(bits).collect()
}

fn message() -> impl Strategy<Value = Message> {
    let text = any::<String>;
    prop_oneof![
        (text(), 1..64_usize, text()).prop_map(|(version, threads, data)| Message::Hello {
            version,
            threads,
            data: data.into(),
        }),
        text().prop_map(|setup| Message::Welcome { setup }),
        text().prop_map(|reason| Message::Refused { reason }),
        text().prop_map(|reason| Message::Failed { reason }),
        Just(Message::Ping),
        Just(Message::Leave),
        Just(Message::End {
            state: EndState::Stopped
        }),
    ]
}

proptest! {
    #[test]
    fn messages_are_read_as_written(message in message()) {
        let mut bytes = Vec::new();
        write_message(&mut bytes, &message).unwrap();
        prop_assert_eq!(read_message(&mut &bytes[..]).unwrap(), message);
    }

    /// NaN payloads included.
    #[test]
    fn jobs_and_sums_are_read_as_written(
        (sizes, weights) in proptest::collection::vec(0..9_usize, 0..4)
            .prop_flat_map(|sizes| (Just(sizes.clone()), values(sizes))),
        step: u64,
        start in 0..9_usize,
        length in 1..9_usize,
        loss: u32,
    ) {
        let part = Part { step, batches: start..start + length };
        let mut bytes = Vec::new();
        write_job(&mut bytes, &part, &weights).unwrap();
        let mut from = &bytes[..];
        let header = read_header(&mut from).unwrap();
        let (read, found) = read_job(&mut from, header, &sizes).unwrap();
        prop_assert!(from.is_empty());
        prop_assert_eq!((&read, bits(&found)), (&part, bits(&weights)));

        let places = covering(part.batches.clone(), start + length + 3);
        let nodes: Vec<Node> = places.iter().map(|place| Node {
            place: *place,
            sum: StepLoss {
                loss: f32::from_bits(loss),
                parts: Vec::new(),
                gradient: weights.clone(),
            },
        }).collect();
        let mut bytes = Vec::new();
        write_sums(&mut bytes, &part, (0.25, &nodes)).unwrap();
        let mut from = &bytes[..];
        let header = read_header(&mut from).unwrap();
        let (seconds, found) = read_sums(&mut from, header, &part, (&places, &sizes)).unwrap();
        prop_assert_eq!(seconds, 0.25);
        prop_assert!(from.is_empty());
        for (found, place) in found.iter().zip(&places) {
            prop_assert_eq!(found.place, *place);
            prop_assert_eq!(found.sum.loss.to_bits(), loss);
            prop_assert_eq!(bits(&found.sum.gradient), bits(&weights));
        }

        // Another part, other sizes, and each beginning are refused.
        let other = Part { step: step ^ 1, ..part.clone() };
        let from = &bytes[9..];
        let refused = read_sums(&mut &*from, header, &other, (&places, &sizes));
        prop_assert!(matches!(refused, Err(FrameError::Part { .. })), "{refused:?}");
        let more = [&sizes[..], &[1]].concat();
        let refused = read_sums(&mut &*from, header, &part, (&places, &more));
        prop_assert!(matches!(refused, Err(FrameError::Length { .. })), "{refused:?}");
        let cut = bytes.len() / 2;
        let mut cut = &bytes[..cut];
        let refused = read_header(&mut cut)
            .and_then(|header| read_sums(&mut cut, header, &part, (&places, &sizes)));
        prop_assert!(matches!(refused, Err(FrameError::Io(_))), "{refused:?}");
    }

    #[test]
    fn arbitrary_bytes_are_refused(bytes: Vec<u8>) {
        let mut from = &bytes[..];
        if let Ok(header) = read_header(&mut from) {
            // No length of a stranger is believed.
            let refused = read_message_body(&mut &*from, header);
            prop_assert!(header.length <= LONGEST_MESSAGE || refused.is_err());
            let part = Part { step: 0, batches: 0..1 };
            let places = covering(0..1, 4);
            prop_assert!(read_job(&mut &*from, header, &[1000]).is_err());
            prop_assert!(read_sums(&mut &*from, header, &part, (&places, &[1000])).is_err());
        }
        prop_assert!(read_magic(&mut &bytes[..]).is_err());
    }
}

#[test]
fn claimed_length_is_refused_without_memory() {
    for (length, body, expected) in [
        (u64::MAX, &b""[..], "at most 262144 bytes"),
        (LONGEST_MESSAGE, b"{}", "closed the connection"),
        (2, b"{}", "missing field"),
    ] {
        let mut bytes = Vec::new();
        write_header(&mut bytes, Kind::Message, length).unwrap();
        bytes.extend(body);
        let error = read_message(&mut &bytes[..]).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}
