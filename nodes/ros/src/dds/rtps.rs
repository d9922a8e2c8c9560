//! The two RTPS messages that this runtime writes itself (DDSI-RTPS 2.5, chapter 9.4), where rustdds 0.15.1 falls short;
//! [`super::wire`] sends them and says why.

use super::parts::{Peer, peer_of};
use crate::backend::{EndpointId, RequestId};
use bytes::{BufMut as _, Bytes, BytesMut};

/// `RTPS`, and version 2.4 of the protocol.
const MAGIC: [u8; 6] = [b'R', b'T', b'P', b'S', 2, 4];

const ACKNACK: u8 = 0x06;
const INFO_TS: u8 = 0x09;
const INFO_DST: u8 = 0x0e;
const DATA: u8 = 0x15;

const LITTLE_ENDIAN: u8 = 0x01;
/// DATA: inline QoS follows.
const INLINE_QOS: u8 = 0x02;
/// ACKNACK: no heartbeat is asked for.
const FINAL: u8 = 0x02;
/// DATA: a serialized payload follows.
const PAYLOAD: u8 = 0x04;

/// Which request a sample answers (DDS-RPC 1.0), and the number that Fast DDS used for it first and still sends.
const PID_RELATED_SAMPLE_IDENTITY: [u16; 2] = [0x0083, 0x800f];
const PID_SENTINEL: u16 = 0x0001;

/// Bytes of a DATA submessage between its field of that name and the inline QoS.
const OCTETS_TO_INLINE_QOS: u16 = 16;

/// The largest datagram that Fast DDS and Cyclone DDS receive \[byte\]; UDP itself takes 7 bytes more.
const LARGEST_DATAGRAM: usize = 65_500;
/// Everything in [`answer`] but the sample.
const ANSWER_OVERHEAD: usize = 20 + 16 + 12 + 24 + 2 * 28 + 4;
/// The largest sample that fits into one [`answer`], its CDR header included \[byte\].
pub(super) const LARGEST_ANSWER: usize = LARGEST_DATAGRAM - ANSWER_OVERHEAD;

/// Says in `reader`'s name that it has everything before `base`.
pub(super) fn acknowledgment(
    reader: &EndpointId,
    writer: &EndpointId,
    base: i64,
    count: i32,
) -> Bytes {
    let mut message = begin(reader, &peer_of(writer));
    submessage(&mut message, ACKNACK, LITTLE_ENDIAN | FINAL, 24);
    message.put_slice(&reader[12..]);
    message.put_slice(&writer[12..]);
    put_number(&mut message, base);
    message.put_u32_le(0); // it asks for none of what follows
    message.put_i32_le(count);
    message.freeze()
}

/// The answer `sample` (CDR with its header) to a request, for `reader`. `number`: of the sample in the numbering of
/// `writer`. `nanos`: when it was written \[ns since 1970\].
pub(super) fn answer(
    writer: &EndpointId,
    number: i64,
    reader: &EndpointId,
    request: &RequestId,
    nanos: i64,
    sample: &[u8],
) -> Bytes {
    let mut message = begin(writer, &peer_of(reader));
    submessage(&mut message, INFO_TS, LITTLE_ENDIAN, 8);
    message.put_u32_le(nanos.div_euclid(1_000_000_000) as u32); // until 2106
    let fraction = (nanos.rem_euclid(1_000_000_000) as u64) << 32;
    message.put_u32_le((fraction / 1_000_000_000) as u32);
    // 0: as far as the message goes, which may be longer than 16 bits count
    submessage(&mut message, DATA, LITTLE_ENDIAN | INLINE_QOS | PAYLOAD, 0);
    message.put_u16_le(0);
    message.put_u16_le(OCTETS_TO_INLINE_QOS);
    message.put_slice(&reader[12..]);
    message.put_slice(&writer[12..]);
    put_number(&mut message, number);
    for parameter in PID_RELATED_SAMPLE_IDENTITY {
        message.put_u16_le(parameter);
        message.put_u16_le(24);
        message.put_slice(&request.client);
        put_number(&mut message, request.sequence);
    }
    message.put_u16_le(PID_SENTINEL);
    message.put_u16_le(0);
    message.put_slice(sample);
    message.freeze()
}

/// A message from the participant of `from` to the participant `to`.
fn begin(from: &EndpointId, to: &Peer) -> BytesMut {
    let mut message = BytesMut::new();
    message.put_slice(&MAGIC);
    message.put_slice(&from[..2]); // an identity begins with its vendor
    message.put_slice(&from[..12]);
    submessage(&mut message, INFO_DST, LITTLE_ENDIAN, 12);
    message.put_slice(to);
    message
}

fn submessage(message: &mut BytesMut, kind: u8, flags: u8, len: u16) {
    message.put_u8(kind);
    message.put_u8(flags);
    message.put_u16_le(len);
}

/// A SequenceNumber_t: the high word first, whatever the byte order.
fn put_number(message: &mut BytesMut, number: i64) {
    message.put_i32_le((number >> 32) as i32);
    message.put_u32_le(number as u32);
}

#[cfg(test)]
mod tests {
    use super::*;

    const READER: EndpointId = [0x01, 0x0f, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 0, 0, 1, 0x04];
    const WRITER: EndpointId = [1, 0x18, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 0, 0, 2, 0x03];

    #[test]
    fn an_acknowledgment_is_as_the_standard_says() {
        let message = acknowledgment(&READER, &WRITER, (7 << 32) + 9, 5);
        assert_eq!(&message[..8], [b'R', b'T', b'P', b'S', 2, 4, 0x01, 0x0f]);
        assert_eq!(message[8..20], READER[..12]);
        assert_eq!(message[20..24], [0x0e, 1, 12, 0]);
        assert_eq!(message[24..36], WRITER[..12]);
        assert_eq!(message[36..40], [0x06, 3, 24, 0]);
        let rest = [
            0, 0, 1, 4, 0, 0, 2, 3, 7, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0, 5, 0, 0, 0,
        ];
        assert_eq!(message[40..], rest);
    }

    #[test]
    fn the_largest_answer_fills_a_datagram() {
        let request = RequestId {
            client: READER,
            sequence: 3,
        };
        let sample = vec![0; LARGEST_ANSWER];
        let message = answer(&WRITER, 1, &READER, &request, 1_500_000_000, &sample);
        assert_eq!(message.len(), LARGEST_DATAGRAM);
        // 1.5 s, as seconds and 2^-32 s
        assert_eq!(message[40..48], [1, 0, 0, 0, 0, 0, 0, 0x80]);
        assert_eq!(message[48..52], [0x15, 7, 0, 0]);
    }
}
