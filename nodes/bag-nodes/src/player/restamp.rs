//! Header stamps moved in place: four bytes of seconds and four of nanoseconds of an otherwise untouched message.

use bytes::{Bytes, BytesMut};
use thiserror::Error;
use wm_bag::{Schema, SchemaEncoding};

/// Where a message that begins with `std_msgs/Header` has its stamp: right after CDR's 4-byte header, seconds
/// (int32) before nanoseconds (uint32).
const SECONDS: std::ops::Range<usize> = 4..8;
const NANOSECONDS: std::ops::Range<usize> = 8..12;

/// Why a stamp cannot be moved.
#[derive(Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum RestampError {
    /// Too short for a header.
    #[error("expected at least 12 bytes for a message with a header, got {0}")]
    TooShort(usize),
    /// An encapsulation whose first field is elsewhere.
    #[error("unknown CDR encapsulation {0:#06x}; expected plain CDR or plain CDR 2 (0, 1, 6, 7)")]
    Encapsulation(u16),
    /// A time that the message cannot express.
    #[error("{0} ns is outside the range of ROS time")]
    OutOfRange(i64),
}

/// Whether the messages of this definition begin with a `std_msgs/Header`. Only `.msg` text is understood.
#[must_use]
pub fn begins_with_header(schema: &Schema) -> bool {
    if schema.encoding != SchemaEncoding::Ros2Msg {
        return false;
    }
    let own = schema
        .text
        .lines()
        .take_while(|line| !line.starts_with("===="))
        .map(|line| line.split_once('#').map_or(line, |(code, _)| code).trim());
    // constants take no place in the message
    let first_field = own
        .into_iter()
        .find(|line| !line.is_empty() && !line.contains('='));
    let first_type = first_field.and_then(|field| field.split_whitespace().next());
    matches!(
        first_type,
        Some("std_msgs/Header" | "std_msgs/msg/Header" | "Header")
    )
}

/// The message with `map` applied to its header's stamp \[ns\].
///
/// # Errors
/// Where the message is too short, of an unknown encapsulation, or the new stamp is no ROS time.
pub fn restamp(cdr: &Bytes, map: impl FnOnce(i64) -> i64) -> Result<Bytes, RestampError> {
    let too_short = || RestampError::TooShort(cdr.len());
    let encapsulation = u16::from_be_bytes(*cdr.first_chunk::<2>().ok_or_else(too_short)?);
    let is_little = match encapsulation {
        0 | 6 => false,
        1 | 7 => true,
        other => return Err(RestampError::Encapsulation(other)),
    };
    let word = |range| {
        cdr.get(range)
            .and_then(|bytes: &[u8]| <[u8; 4]>::try_from(bytes).ok())
            .ok_or_else(too_short)
    };
    let (seconds, nanoseconds) = (word(SECONDS)?, word(NANOSECONDS)?);
    let (seconds, nanoseconds) = if is_little {
        (i32::from_le_bytes(seconds), u32::from_le_bytes(nanoseconds))
    } else {
        (i32::from_be_bytes(seconds), u32::from_be_bytes(nanoseconds))
    };
    let moved_ns = map(i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds));
    let out_of_range = |_| RestampError::OutOfRange(moved_ns);
    let seconds = i32::try_from(moved_ns.div_euclid(1_000_000_000)).map_err(out_of_range)?;
    let nanoseconds = u32::try_from(moved_ns.rem_euclid(1_000_000_000)).map_err(out_of_range)?;
    let (seconds, nanoseconds) = if is_little {
        (seconds.to_le_bytes(), nanoseconds.to_le_bytes())
    } else {
        (seconds.to_be_bytes(), nanoseconds.to_be_bytes())
    };
    let mut moved = BytesMut::from(cdr.as_ref());
    moved
        .get_mut(SECONDS)
        .ok_or_else(too_short)?
        .copy_from_slice(&seconds);
    moved
        .get_mut(NANOSECONDS)
        .ok_or_else(too_short)?
        .copy_from_slice(&nanoseconds);
    Ok(moved.freeze())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use wm_bag::type_schema;
    use wm_msgs::{builtin_interfaces::Time, cdr, std_msgs, wm_msgs::Action};

    #[test]
    fn only_the_stamp_changes() {
        let header = std_msgs::Header {
            stamp: Time::from_nanos(5_000_000_007),
            frame_id: "base_link".to_owned(),
        };
        let action = Action {
            header,
            values: vec![0.5; 7],
        };
        let bytes = Bytes::from(cdr::to_bytes(&action).unwrap());
        let moved: Action =
            cdr::from_bytes(&restamp(&bytes, |stamp| stamp + 2_999_999_999).unwrap()).unwrap();
        assert_eq!(moved.header.stamp.to_nanos(), 8_000_000_006);
        let back = Action {
            header: action.header.clone(),
            ..moved
        };
        assert_eq!(back, action);
    }

    #[test]
    fn big_endian_is_read_too() {
        let bytes = Bytes::from_static(&[0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2, 9]);
        let moved = restamp(&bytes, |stamp| stamp + 1).unwrap();
        assert_eq!(moved.as_ref(), &[0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 3, 9]);
    }

    #[test]
    fn what_cannot_be_moved_is_named() {
        assert_eq!(
            restamp(&Bytes::from_static(&[0, 1, 0, 0, 1]), |s| s),
            Err(RestampError::TooShort(5))
        );
        let parameter_list = Bytes::from_static(&[0, 3, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(
            restamp(&parameter_list, |s| s),
            Err(RestampError::Encapsulation(3))
        );
        let plain = Bytes::from_static(&[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(
            restamp(&plain, |_| i64::MAX),
            Err(RestampError::OutOfRange(i64::MAX))
        );
    }

    #[test]
    fn headers_are_found_in_definitions() {
        assert!(begins_with_header(&type_schema::<Action>()));
        assert!(!begins_with_header(&type_schema::<std_msgs::String>()));
        let commented = "# a comment: std_msgs/Header\nuint8 A=1 # constant\n\nstd_msgs/Header header # stamp\nint32 x\n";
        assert!(begins_with_header(&Schema::ros2msg(commented)));
        assert!(!begins_with_header(&Schema::ros2msg(
            "int32 x\nstd_msgs/Header header\n"
        )));
        let idl = Schema {
            encoding: SchemaEncoding::Ros2Idl,
            text: "std_msgs/Header header".to_owned(),
        };
        assert!(!begins_with_header(&idl));
    }

    proptest! {
        #[test]
        fn any_bytes_move_or_err(bytes in prop::collection::vec(any::<u8>(), 0..32), to in any::<i64>()) {
            let bytes = Bytes::from(bytes);
            if let Ok(moved) = restamp(&bytes, |_| to) {
                prop_assert_eq!(moved.len(), bytes.len());
                let mut read_back = 0;
                restamp(&moved, |stamp| { read_back = stamp; stamp }).unwrap();
                prop_assert_eq!(read_back, to);
            }
        }
    }
}
