//! The attachment that identifies a service call on Zenoh, in the format of the ros2dds bridge: `rqh`, the client's id
//! (8 bytes), the call's number (8 bytes), and 1 if both are little-endian. The real bridge identifies open calls by
//! it, so it must be unique in the network.

const KEY: [u8; 3] = *b"rqh";
/// Key, header, endianness.
pub(crate) const LEN: usize = 3 + 16 + 1;

/// The client and the number of a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RequestHeader {
    pub client: u64,
    pub sequence: u64,
}

impl RequestHeader {
    /// The header of a DDS call. A GUID has 16 bytes, the header only 8. Both halves are combined: clients of one
    /// participant differ in the last half, clients of two in the first.
    pub(crate) fn of_call((client, sequence): ([u8; 16], i64)) -> Self {
        let guid = u128::from_le_bytes(client);
        // the halves of the GUID, and the two's complement of a number that is never negative
        let (low, high, sequence) = (guid as u64, (guid >> 64) as u64, sequence as u64);
        Self {
            client: low ^ high.rotate_left(32),
            sequence,
        }
    }

    pub(crate) fn to_bytes(self) -> [u8; LEN] {
        let mut bytes = [0; LEN];
        let fields = KEY
            .into_iter()
            .chain(self.client.to_le_bytes())
            .chain(self.sequence.to_le_bytes())
            .chain([1]);
        for (place, byte) in bytes.iter_mut().zip(fields) {
            *place = byte;
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Parses like the real bridge: for any other length or key, that bridge makes up a header of its own.
    fn read(bytes: &[u8]) -> Option<RequestHeader> {
        let (key, rest) = bytes.split_first_chunk::<3>()?;
        let rest: [u8; 17] = rest.try_into().ok()?;
        let word = |at: usize| u64::from_le_bytes(rest[at..at + 8].try_into().unwrap());
        (*key == KEY && rest[16] == 1).then(|| RequestHeader {
            client: word(0),
            sequence: word(8),
        })
    }

    #[test]
    fn bytes_match_the_real_bridges() {
        let header = RequestHeader {
            client: 0x0807_0605_0403_0201,
            sequence: 9,
        };
        let bytes = header.to_bytes();
        assert_eq!(
            bytes,
            *b"rqh\x01\x02\x03\x04\x05\x06\x07\x08\x09\0\0\0\0\0\0\0\x01"
        );
    }

    proptest! {
        #[test]
        fn a_header_survives(client: u64, sequence: u64) {
            let header = RequestHeader { client, sequence };
            prop_assert_eq!(read(&header.to_bytes()), Some(header));
        }

        #[test]
        fn clients_that_differ_in_one_half_differ(guid: [u8; 16], other: [u8; 8], is_first: bool) {
            let mut changed = guid;
            let half = if is_first { &mut changed[..8] } else { &mut changed[8..] };
            half.copy_from_slice(&other);
            prop_assume!(changed != guid);
            prop_assert_ne!(RequestHeader::of_call((guid, 1)), RequestHeader::of_call((changed, 1)));
        }
    }
}
