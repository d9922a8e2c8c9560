//! RTPS messages (DDSI-RTPS 2.5, chapter 9.4) that rustdds 0.15.1 cannot send. [`super::wire`], [`super::resend`],
//! [`super::introduction`] and [`super::lease`] send them and explain why.

use crate::{
    backend::{EndpointId, RequestId},
    dds::identity::Peer,
    dds::identity::participant_of,
};
use bytes::{BufMut as _, Bytes, BytesMut};
use rustdds::Timestamp;
use std::net::Ipv4Addr;

/// `RTPS`, and version 2.4 of the protocol.
const MAGIC: [u8; 6] = [b'R', b'T', b'P', b'S', 2, 4];

const INFO_TS: u8 = 0x09;
const INFO_DST: u8 = 0x0e;
const DATA: u8 = 0x15;
const DATA_FRAG: u8 = 0x16;

const LITTLE_ENDIAN: u8 = 0x01;
/// DATA: inline QoS follows.
const INLINE_QOS: u8 = 0x02;
/// DATA: a serialized payload follows.
const PAYLOAD: u8 = 0x04;
/// DATA: the key of a disposed instance follows.
const KEY: u8 = 0x08;

/// The request of a response (DDS-RPC 1.0): the standard's number, and an older one that Fast DDS still sends.
const PID_RELATED_SAMPLE_IDENTITY: [u16; 2] = [0x0083, 0x800f];
const PID_SENTINEL: u16 = 0x0001;

/// Parameters of an announcement (9.6.2.2).
const PID_LEASE_DURATION: u16 = 0x0002;
const PID_PROTOCOL_VERSION: u16 = 0x0015;
const PID_VENDOR_ID: u16 = 0x0016;
const PID_DEFAULT_UNICAST_LOCATOR: u16 = 0x0031;
const PID_METATRAFFIC_UNICAST_LOCATOR: u16 = 0x0032;
const PID_PARTICIPANT_GUID: u16 = 0x0050;
const PID_BUILTIN_ENDPOINT_SET: u16 = 0x0058;
/// The discovery endpoints of every rustdds 0.15.1 participant (`BuiltinEndpointSet`).
const BUILTIN_ENDPOINTS: u32 = 0x1800_0c3f;
/// As in rustdds' `Discovery::spdp_publish` \[s\].
const LEASE: u32 = 50;
/// The writer of announcements (9.3.1.3); any reader.
const SPDP_WRITER: [u8; 4] = [0, 1, 0, 0xc2];
const ANY_READER: [u8; 4] = [0; 4];
const SPDP_READER: [u8; 4] = [0, 1, 0, 0xc7];
/// The last bytes of a participant's identity.
const PARTICIPANT: [u8; 4] = [0, 0, 1, 0xc1];
/// A parameter list in little-endian CDR.
const PL_CDR_LE: [u8; 4] = [0, 3, 0, 0];
const UDP_V4: u32 = 1;

/// Bytes of a DATA submessage between its field of that name and the inline QoS.
const OCTETS_TO_INLINE_QOS: u16 = 16;

/// The same in a DATA_FRAG submessage.
const OCTETS_TO_INLINE_QOS_OF_FRAGMENTS: u16 = 28;
/// The fragment size of rustdds 0.15.1 \[byte\].
pub(in crate::dds) const FRAGMENT: usize = 256;

/// The largest datagram that Fast DDS and Cyclone DDS receive \[byte\]; UDP allows 7 bytes more.
const LARGEST_DATAGRAM: usize = 65_500;
/// [`answer`] without the sample.
const ANSWER_OVERHEAD: usize = 20 + 16 + 12 + 24 + 2 * 28 + 4;
/// The largest sample that fits into one [`answer`], with its CDR header \[byte\].
pub(in crate::dds) const LARGEST_ANSWER: usize = LARGEST_DATAGRAM - ANSWER_OVERHEAD;

/// The response `sample` (CDR with its header) to a request, for `reader`. `number`: of the sample at `writer`.
/// `nanos`: when it was written \[ns since 1970\].
pub(in crate::dds) fn answer(
    writer: &EndpointId,
    number: i64,
    reader: &EndpointId,
    request: &RequestId,
    nanos: i64,
    sample: &[u8],
) -> Bytes {
    let mut message = begin(writer, &participant_of(reader));
    submessage(&mut message, INFO_TS, LITTLE_ENDIAN, 8);
    message.put_u32_le(nanos.div_euclid(1_000_000_000) as u32); // the year 2106
    let fraction = (nanos.rem_euclid(1_000_000_000) as u64) << 32;
    message.put_u32_le((fraction / 1_000_000_000) as u32);
    // 0: until the end of the message, whose length may exceed 16 bits
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

/// Some fragments of a sample.
pub(in crate::dds) struct Fragments {
    /// The sample's number at its writer.
    pub(in crate::dds) number: i64,
    /// When the sample was written.
    pub(in crate::dds) time: Timestamp,
    /// The number of the first fragment; the sample begins with fragment 1.
    pub(in crate::dds) first: u32,
    /// How many; the sample may end earlier.
    pub(in crate::dds) count: u16,
}

/// Fragments of `sample` (CDR with its header) for `reader` (8.3.8.3); empty past its end.
pub(in crate::dds) fn fragments(
    writer: &EndpointId,
    reader: &EndpointId,
    fragments: &Fragments,
    sample: &[u8],
) -> Bytes {
    let Fragments {
        number,
        time,
        first,
        count,
    } = fragments;
    let begin_at = (*first as usize).saturating_sub(1) * FRAGMENT;
    // empty for a fragment after the end; the last fragment is shorter
    let rest = sample.get(begin_at..).unwrap_or_default();
    let payload = rest.get(..FRAGMENT * usize::from(*count)).unwrap_or(rest);
    let count = payload.len().div_ceil(FRAGMENT) as u16; // at most `count`
    let mut message = begin(writer, &participant_of(reader));
    submessage(&mut message, INFO_TS, LITTLE_ENDIAN, 8);
    let ticks = time.to_ticks();
    message.put_u32_le((ticks >> 32) as u32);
    message.put_u32_le(ticks as u32);
    // 0: until the end of the message
    submessage(&mut message, DATA_FRAG, LITTLE_ENDIAN, 0);
    message.put_u16_le(0);
    message.put_u16_le(OCTETS_TO_INLINE_QOS_OF_FRAGMENTS);
    message.put_slice(&reader[12..]);
    message.put_slice(&writer[12..]);
    put_number(&mut message, *number);
    message.put_u32_le(*first);
    message.put_u16_le(count);
    message.put_u16_le(FRAGMENT as u16);
    message.put_u32_le(sample.len() as u32); // a limit of RTPS
    message.put_slice(payload);
    message.freeze()
}

/// The first announcement of the participant `own` on loopback, with these ports (8.5.3).
pub(in crate::dds) fn announcement(own: &EndpointId, discovery: u16, user: u16) -> Bytes {
    let mut message = header(own);
    let data = participant(own, BUILTIN_ENDPOINTS, LEASE, Some([discovery, user]));
    announced(&mut message, ANY_READER, PAYLOAD, &data, 1);
    message.freeze()
}

/// The data of a participant (9.6.2.2). `lease` in seconds; `ports`: for discovery and for samples, on loopback.
fn participant(id: &EndpointId, endpoints: u32, lease: u32, ports: Option<[u16; 2]>) -> BytesMut {
    let mut data = BytesMut::new();
    data.put_slice(&PL_CDR_LE);
    let mut put = |parameter: u16, value: &[u8]| {
        data.put_u16_le(parameter);
        data.put_u16_le(value.len() as u16); // at most 24
        data.put_slice(value);
    };
    put(PID_PROTOCOL_VERSION, &[MAGIC[4], MAGIC[5], 0, 0]);
    put(PID_VENDOR_ID, &[id[0], id[1], 0, 0]);
    put(PID_PARTICIPANT_GUID, id);
    if let Some([discovery, user]) = ports {
        put(PID_METATRAFFIC_UNICAST_LOCATOR, &locator(discovery));
        put(PID_DEFAULT_UNICAST_LOCATOR, &locator(user));
    }
    let lease = [lease, 0].map(u32::to_le_bytes).concat();
    put(PID_LEASE_DURATION, &lease);
    put(PID_BUILTIN_ENDPOINT_SET, &endpoints.to_le_bytes());
    put(PID_SENTINEL, &[]);
    data
}

fn locator(port: u16) -> BytesMut {
    let mut locator = BytesMut::new();
    locator.put_u32_le(UDP_V4);
    locator.put_u32_le(port.into());
    locator.put_slice(&[0; 12]);
    locator.put_slice(&Ipv4Addr::LOCALHOST.octets());
    locator
}

/// Renews the lease of the participant `own`: an announcement without content.
pub(in crate::dds) fn life_sign(own: &EndpointId) -> Bytes {
    let mut message = header(own);
    announced(&mut message, SPDP_READER, 0, &[], 1);
    message.freeze()
}

/// A fictitious participant that only the own participant discovers.
fn fictitious(own: &EndpointId) -> EndpointId {
    let mut id = *own;
    id[2..12].fill(0xff);
    id[12..].copy_from_slice(&PARTICIPANT);
    id
}

/// The fictitious participant joins and leaves; uses this number and the next.
pub(in crate::dds) fn visit(own: &EndpointId, number: i64) -> Bytes {
    let id = fictitious(own);
    let mut message = header(&id);
    let data = participant(&id, 0, 1, None);
    announced(&mut message, SPDP_READER, PAYLOAD, &data, number);
    announced(&mut message, SPDP_READER, KEY, &key(&id), number + 1);
    message.freeze()
}

/// The fictitious participant leaves, once for each of `numbers`.
pub(in crate::dds) fn departures(own: &EndpointId, numbers: impl Iterator<Item = i64>) -> Bytes {
    let id = fictitious(own);
    let mut message = header(&id);
    for number in numbers {
        announced(&mut message, SPDP_READER, KEY, &key(&id), number);
    }
    message.freeze()
}

/// Ends the lease of the participant `peer` within a second.
pub(in crate::dds) fn expiry(own: &EndpointId, peer: &Peer, number: i64) -> Bytes {
    let mut id = fictitious(own);
    let mut message = header(&id);
    id[..12].copy_from_slice(peer);
    let data = participant(&id, 0, 1, None);
    announced(&mut message, SPDP_READER, PAYLOAD, &data, number);
    message.freeze()
}

fn key(participant: &EndpointId) -> BytesMut {
    let mut key = BytesMut::new();
    key.put_slice(&PL_CDR_LE);
    key.put_u16_le(PID_PARTICIPANT_GUID);
    key.put_u16_le(16);
    key.put_slice(participant);
    key.put_u16_le(PID_SENTINEL);
    key.put_u16_le(0);
    key
}

fn announced(message: &mut BytesMut, reader: [u8; 4], flags: u8, payload: &[u8], number: i64) {
    const HEADER: u16 = 4 + OCTETS_TO_INLINE_QOS;
    let len = HEADER + payload.len() as u16; // at most 120
    submessage(message, DATA, LITTLE_ENDIAN | flags, len);
    message.put_u16_le(0);
    message.put_u16_le(OCTETS_TO_INLINE_QOS);
    message.put_slice(&reader);
    message.put_slice(&SPDP_WRITER);
    put_number(message, number);
    message.put_slice(payload);
}

/// The header of a message from the participant of `from`.
fn header(from: &EndpointId) -> BytesMut {
    let mut message = BytesMut::new();
    message.put_slice(&MAGIC);
    message.put_slice(&from[..2]); // an identity begins with its vendor
    message.put_slice(&from[..12]);
    message
}

/// The header of a message from the participant of `from` to the participant `to`.
fn begin(from: &EndpointId, to: &Peer) -> BytesMut {
    let mut message = header(from);
    submessage(&mut message, INFO_DST, LITTLE_ENDIAN, 12);
    message.put_slice(to);
    message
}

fn submessage(message: &mut BytesMut, kind: u8, flags: u8, len: u16) {
    message.put_u8(kind);
    message.put_u8(flags);
    message.put_u16_le(len);
}

/// A SequenceNumber_t: the high word comes first in either byte order.
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
    fn departures_come_from_the_fictitious_participant() {
        let message = departures(&READER, [64, 128].into_iter());
        assert_eq!(message[8..20], [&READER[..2], &[0xff; 10]].concat());
        assert_eq!(message.len(), 20 + 2 * 52);
        for (at, number) in [(20, 64), (72, 128)] {
            assert_eq!(message[at..at + 4], [DATA, 0x09, 48, 0]);
            assert_eq!(message[at + 8..at + 12], SPDP_READER);
            assert_eq!(message[at + 20..at + 24], [number, 0, 0, 0]);
            assert_eq!(message[at + 48..at + 52], [1, 0, 0, 0]);
        }
        assert_eq!(life_sign(&READER).len(), 20 + 4 + 20);
    }

    #[test]
    fn largest_answer_fills_a_datagram() {
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
