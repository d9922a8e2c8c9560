//! The attachment of every sample, request and answer: 33 bytes.

use crate::backend::EndpointId;
use zenoh::bytes::ZBytes;
use zenoh_ext::{ZDeserializeError, ZDeserializer, ZSerializer};

/// The sender of a sample, and the number of the sample. An answer has the sender and the number of its request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Attachment {
    /// From 1, in steps of 1.
    pub(super) sequence: i64,
    /// When it was sent, by the system clock \[ns since 1970\].
    pub(super) sent: i64,
    pub(super) sender: EndpointId,
}

impl Attachment {
    pub(super) fn to_bytes(self) -> ZBytes {
        let mut serializer = ZSerializer::new();
        serializer.serialize(self.sequence);
        serializer.serialize(self.sent);
        serializer.serialize(self.sender);
        serializer.finish()
    }

    /// # Errors
    /// The reason, for a log: no attachment, or one of another program.
    pub(super) fn read(bytes: Option<&ZBytes>) -> Result<Self, String> {
        let bytes = bytes
            .ok_or("it has no attachment: its sender does not speak the format of rmw_zenoh")?;
        let malformed = |_: ZDeserializeError| {
            format!(
                "expected an attachment of 33 bytes (rmw_zenoh), got {}",
                bytes.len()
            )
        };
        let mut deserializer = ZDeserializer::new(bytes);
        Ok(Self {
            sequence: deserializer.deserialize().map_err(malformed)?,
            sent: deserializer.deserialize().map_err(malformed)?,
            sender: deserializer.deserialize().map_err(malformed)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn bytes_are_those_of_rmw_zenoh() {
        let attachment = Attachment {
            sequence: 1,
            sent: 2,
            sender: [7; 16],
        };
        let expected = [
            &[1, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 16][..],
            &[7; 16],
        ]
        .concat();
        assert_eq!(attachment.to_bytes().to_bytes(), expected);
        assert!(
            Attachment::read(None)
                .unwrap_err()
                .contains("no attachment")
        );
    }

    proptest! {
        #[test]
        fn attachments_survive(sequence: i64, sent: i64, sender: [u8; 16]) {
            let attachment = Attachment { sequence, sent, sender };
            prop_assert_eq!(Attachment::read(Some(&attachment.to_bytes())), Ok(attachment));
        }

        #[test]
        fn arbitrary_bytes_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..40)) {
            Attachment::read(Some(&ZBytes::from(bytes))).ok();
        }
    }
}
