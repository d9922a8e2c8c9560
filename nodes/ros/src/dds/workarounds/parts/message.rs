//! The messages of the parts protocol.

use crate::{backend::EndpointId, dds::identity::Peer};
use bytes::Bytes;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use wm_msgs::cdr::{self, CdrError};

/// The largest part \[byte\]: with its headers it fills one datagram of loopback.
pub(super) const PART: usize = 60_000;

/// The largest message in parts \[byte\].
pub(in crate::dds) const LARGEST: usize = 256 << 20;

/// A message to a participant.
#[derive(Clone, Debug)]
pub(super) struct Mail {
    pub(super) to: Peer,
    pub(super) message: PartMessage,
}

/// A message, by its number at its writer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct MessageId {
    pub(super) writer: EndpointId,
    pub(super) number: i64,
}

/// The data about a message that each offer and each part contains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Outline {
    pub(super) id: MessageId,
    /// The whole message \[byte\], 1 to [`LARGEST`].
    pub(super) len: usize,
    /// The last number that the writer used on its topic before it switched to parts. Later samples of the topic arrive
    /// in parts too.
    pub(super) base: i64,
    /// The number of the same message on the topic; 0 if it was not sent there.
    pub(super) copy: i64,
}

impl Outline {
    pub(super) fn parts(&self) -> u32 {
        // LARGEST / PART fits
        self.len.div_ceil(PART) as u32
    }

    /// The bytes of a part.
    pub(super) fn range(&self, index: u32) -> Range<usize> {
        let begin = (index as usize).saturating_mul(PART).min(self.len);
        begin..(begin + PART).min(self.len)
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum PartMessage {
    /// From the writer: a message exists. The first offer contains the first part. `first`: the oldest message that the
    /// writer keeps for this reader.
    Offer {
        of: Outline,
        first: i64,
        head: Bytes,
    },
    /// From a reader: requests a part.
    Want { id: MessageId, index: u32 },
    /// From the writer: a part.
    Part {
        of: Outline,
        index: u32,
        bytes: Bytes,
    },
    /// From the writer: it no longer keeps the message.
    Gone { id: MessageId },
    /// From a reader: it has taken or dropped every message up to this number.
    Settled { id: MessageId },
}

#[repr(u8)]
enum Kind {
    Offer,
    Want,
    Part,
    Gone,
    Settled,
}

/// The encoding: one layout for all kinds.
#[derive(Serialize, Deserialize)]
struct Wire {
    kind: u8,
    writer: EndpointId,
    number: i64,
    len: u32,
    base: i64,
    copy: i64,
    first: i64,
    index: u32,
    #[serde(with = "serde_bytes")]
    bytes: Vec<u8>,
}

#[derive(Debug, thiserror::Error)]
pub(super) enum PartError {
    #[error(transparent)]
    Cdr(#[from] CdrError),
    #[error("expected a kind of 0 to 4, got {0}")]
    Kind(u8),
    #[error("expected a length of 1 to {LARGEST} bytes, got {0}")]
    Len(u32),
    #[error("expected part {index} of a message of {len} bytes to have {expected}, got {got}")]
    Part {
        index: u32,
        len: usize,
        expected: usize,
        got: usize,
    },
}

impl PartMessage {
    /// The writer whose participant alone may send this; `None` for messages of readers.
    pub(super) fn required_sender(&self) -> Option<&EndpointId> {
        match self {
            Self::Offer { of, .. } | Self::Part { of, .. } => Some(&of.id.writer),
            Self::Gone { id } => Some(&id.writer),
            Self::Want { .. } | Self::Settled { .. } => None,
        }
    }

    pub(super) fn encode(self) -> Result<Bytes, CdrError> {
        let mut first_number = 0;
        let (kind, outline, index, bytes) = match self {
            Self::Offer { of, first, head } => {
                first_number = first;
                (Kind::Offer, of, 0, head)
            }
            Self::Part { of, index, bytes } => (Kind::Part, of, index, bytes),
            Self::Want { id, index } => (Kind::Want, Outline::only(id), index, Bytes::new()),
            Self::Gone { id } => (Kind::Gone, Outline::only(id), 0, Bytes::new()),
            Self::Settled { id } => (Kind::Settled, Outline::only(id), 0, Bytes::new()),
        };
        let wire = Wire {
            kind: kind as u8,
            writer: outline.id.writer,
            number: outline.id.number,
            len: outline.len as u32, // at most LARGEST
            base: outline.base,
            copy: outline.copy,
            first: first_number,
            index,
            bytes: bytes.into(),
        };
        Ok(cdr::to_bytes(&wire)?.into())
    }

    pub(super) fn decode(sample: &[u8]) -> Result<Self, PartError> {
        let wire: Wire = cdr::from_bytes(sample)?;
        let id = MessageId {
            writer: wire.writer,
            number: wire.number,
        };
        let outline = || match wire.len as usize {
            len @ 1..=LARGEST => Ok(Outline {
                id,
                len,
                base: wire.base,
                copy: wire.copy,
            }),
            _ => Err(PartError::Len(wire.len)),
        };
        let index = wire.index;
        match wire.kind {
            kind if kind == Kind::Offer as u8 => {
                let of = outline()?;
                if !wire.bytes.is_empty() {
                    check(&of, 0, wire.bytes.len())?;
                }
                Ok(Self::Offer {
                    of,
                    first: wire.first.min(id.number),
                    head: wire.bytes.into(),
                })
            }
            kind if kind == Kind::Part as u8 => {
                let of = outline()?;
                check(&of, index, wire.bytes.len())?;
                let bytes = wire.bytes.into();
                Ok(Self::Part { of, index, bytes })
            }
            kind if kind == Kind::Want as u8 => Ok(Self::Want { id, index }),
            kind if kind == Kind::Gone as u8 => Ok(Self::Gone { id }),
            kind if kind == Kind::Settled as u8 => Ok(Self::Settled { id }),
            kind => Err(PartError::Kind(kind)),
        }
    }
}

impl Outline {
    /// Of a message whose data is not sent.
    const fn only(id: MessageId) -> Self {
        let (len, base, copy) = (0, 0, 0);
        Self {
            id,
            len,
            base,
            copy,
        }
    }
}

fn check(of: &Outline, index: u32, got: usize) -> Result<(), PartError> {
    let expected = of.range(index).len();
    if expected == 0 || got != expected {
        let len = of.len;
        return Err(PartError::Part {
            index,
            len,
            expected,
            got,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn outline() -> impl Strategy<Value = Outline> {
        let id = (any::<EndpointId>(), any::<i64>());
        (id, 1..=3 * PART, any::<i64>(), any::<i64>()).prop_map(|(id, len, base, copy)| Outline {
            id: MessageId {
                writer: id.0,
                number: id.1,
            },
            len,
            base,
            copy,
        })
    }

    fn message() -> impl Strategy<Value = PartMessage> {
        let zeros = |len| Bytes::from(vec![0; len]);
        prop_oneof![
            (outline(), any::<bool>()).prop_map(move |(of, has_head)| PartMessage::Offer {
                of,
                first: of.id.number.saturating_sub(1),
                head: zeros(if has_head { of.range(0).len() } else { 0 }),
            }),
            (outline(), any::<u32>()).prop_map(move |(of, index)| {
                let index = index % of.parts();
                let bytes = zeros(of.range(index).len());
                PartMessage::Part { of, index, bytes }
            }),
            (outline(), any::<u32>())
                .prop_map(|(of, index)| PartMessage::Want { id: of.id, index }),
            outline().prop_map(|of| PartMessage::Gone { id: of.id }),
            outline().prop_map(|of| PartMessage::Settled { id: of.id }),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn encoded_messages_are_decoded(message in message()) {
            let bytes = message.clone().encode().unwrap();
            prop_assert_eq!(PartMessage::decode(&bytes).unwrap(), message);
        }

        #[test]
        fn arbitrary_bytes_do_not_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..99), kind in 0u8..6) {
            bytes.splice(0..bytes.len().min(5), [0, 1, 0, 0, kind]);
            PartMessage::decode(&bytes).ok();
        }
    }

    #[test]
    fn parts_of_the_wrong_size_are_refused() {
        let id = MessageId {
            writer: [1; 16],
            number: 1,
        };
        let of = Outline {
            id,
            len: PART + 5,
            base: 0,
            copy: 0,
        };
        assert_eq!((of.parts(), of.range(1)), (2, PART..PART + 5));
        for (len, index, got) in [(of.len, 1, 6), (of.len, 2, 5), (of.len, 0, 5), (0, 0, 5)] {
            let of = Outline { len, ..of };
            let bytes = Bytes::from(vec![0; got]);
            let sample = PartMessage::Part { of, index, bytes }.encode().unwrap();
            assert!(PartMessage::decode(&sample).is_err(), "{len} {index} {got}");
        }
    }
}
