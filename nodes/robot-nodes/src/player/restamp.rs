//! Changes of header stamps in place: four bytes of seconds and four of nanoseconds, while the other bytes of the message
//! stay. Frames and markers have their headers in lists, so they are decoded and encoded again.

use bytes::{Bytes, BytesMut};
use thiserror::Error;
use wm_bag::{Schema, SchemaEncoding};
use wm_msgs::{
    InvalidNanoseconds, Message,
    builtin_interfaces::Time,
    cdr::{self, CdrError},
    std_msgs::Header,
    tf2_msgs::TFMessage,
    visualization_msgs::MarkerArray,
};

/// The bytes of the stamp in a message that begins with `std_msgs/Header`: after CDR's 4-byte header, seconds (int32), then
/// nanoseconds (uint32).
const SECONDS: std::ops::Range<usize> = 4..8;
const NANOSECONDS: std::ops::Range<usize> = 8..12;

/// The reason why a stamp cannot be changed.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RestampError {
    /// The message is too short for a header.
    #[error("expected at least 12 bytes for a message with a header, got {0}")]
    TooShort(usize),
    /// In this encapsulation, the first field has another place.
    #[error("unknown CDR encapsulation {0:#06x}; expected plain CDR or plain CDR 2 (0, 1, 6, 7)")]
    Encapsulation(u16),
    /// Frames or markers cannot be decoded or encoded.
    #[error(transparent)]
    Cdr(#[from] CdrError),
    /// The stamp is malformed.
    #[error("malformed stamp: {0}")]
    Malformed(#[from] InvalidNanoseconds),
    /// The new time is outside the range of ROS time.
    #[error("{0} ns is outside the range of ROS time")]
    OutOfRange(i64),
}

/// The place of the stamps in the messages of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampPlace {
    /// In the header at the beginning.
    Header,
    /// In the header of each frame: `tf2_msgs/msg/TFMessage`.
    Frames,
    /// In the header of each shape: `visualization_msgs/msg/MarkerArray`.
    Markers,
}

impl StampPlace {
    /// The place in messages of this type and definition; `None` if they have no stamps.
    #[must_use]
    pub fn of(type_name: &str, schema: &Schema) -> Option<Self> {
        // In another definition, the headers have unknown places.
        if type_name == TFMessage::ros_name() {
            schema.has_fields_of::<TFMessage>().then_some(Self::Frames)
        } else if type_name == MarkerArray::ros_name() {
            schema
                .has_fields_of::<MarkerArray>()
                .then_some(Self::Markers)
        } else {
            begins_with_header(schema).then_some(Self::Header)
        }
    }

    /// The message with `map` applied to its stamps \[ns\]. In frames and shapes, a stamp of zero means any time, and
    /// stays.
    ///
    /// # Errors
    /// Those of [`restamp`], and of decoding frames or shapes.
    pub fn restamp(
        self,
        cdr: &Bytes,
        mut map: impl FnMut(i64) -> i64,
    ) -> Result<Bytes, RestampError> {
        let mut moved = |header: &mut Header| -> Result<(), RestampError> {
            if header.stamp != Time::default() {
                let moved_ns = map(header.stamp.to_nanos());
                header.stamp = Time::from_nanos(moved_ns);
                // A time out of range saturates.
                if header.stamp.to_nanos() != moved_ns {
                    return Err(RestampError::OutOfRange(moved_ns));
                }
            }
            Ok(())
        };
        match self {
            Self::Header => restamp(cdr, map),
            Self::Frames => {
                let mut message: TFMessage = cdr::from_bytes(cdr)?;
                for frame in &mut message.transforms {
                    moved(&mut frame.header)?;
                }
                Ok(cdr::to_bytes(&message)?.into())
            }
            Self::Markers => {
                let mut message: MarkerArray = cdr::from_bytes(cdr)?;
                for marker in &mut message.markers {
                    moved(&mut marker.header)?;
                }
                Ok(cdr::to_bytes(&message)?.into())
            }
        }
    }
}

/// Whether the messages of this definition begin with a `std_msgs/Header`. False if it is not `.msg` text.
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
    // Constants have no bytes in the message.
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
/// The message is too short, its encapsulation is unknown, or the new stamp is outside the range of ROS time.
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
    let stamp = Time {
        sec: seconds,
        nanosec: nanoseconds,
    };
    let moved_ns = map(stamp.checked_nanos()?);
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
    use wm_msgs::{
        geometry_msgs::TransformStamped, std_msgs, visualization_msgs::Marker, wm_msgs::Action,
    };

    fn header(stamp_ns: i64) -> Header {
        Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: "base_link".to_owned(),
        }
    }

    fn stamp_place<M: Message>() -> Option<StampPlace> {
        StampPlace::of(&M::ros_name(), &type_schema::<M>())
    }

    #[test]
    fn nonzero_stamps_of_frames_and_shapes_change() {
        let stamps = [5, 0, 7];
        let frame = |stamp_ns: i64| TransformStamped {
            header: header(stamp_ns),
            child_frame_id: "tool".to_owned(),
            ..TransformStamped::default()
        };
        let shape = |stamp_ns: i64| Marker {
            header: header(stamp_ns),
            ns: "plan".to_owned(),
            ..Marker::default()
        };
        let frames = |add: i64| TFMessage {
            transforms: stamps
                .map(|at| frame(at + if at == 0 { 0 } else { add }))
                .to_vec(),
        };
        let shapes = |add: i64| MarkerArray {
            markers: stamps
                .map(|at| shape(at + if at == 0 { 0 } else { add }))
                .to_vec(),
        };
        let bytes = |message: Vec<u8>| Bytes::from(message);
        let (before, after) = (frames(0), frames(1_000_000_000));
        let moved = stamp_place::<TFMessage>().unwrap();
        let moved = moved.restamp(&bytes(cdr::to_bytes(&before).unwrap()), |ns| {
            ns + 1_000_000_000
        });
        assert_eq!(moved.unwrap(), cdr::to_bytes(&after).unwrap());
        let (before, after) = (shapes(0), shapes(3));
        let moved = stamp_place::<MarkerArray>().unwrap();
        let moved = moved.restamp(&bytes(cdr::to_bytes(&before).unwrap()), |ns| ns + 3);
        assert_eq!(moved.unwrap(), cdr::to_bytes(&after).unwrap());
    }

    #[test]
    fn frames_that_cannot_be_read_or_moved_are_named() {
        let place = stamp_place::<TFMessage>().unwrap();
        let broken = Bytes::from_static(&[0, 1, 0, 0, 255, 255, 255, 255]);
        assert!(matches!(
            place.restamp(&broken, |ns| ns),
            Err(RestampError::Cdr(_))
        ));
        let message = TFMessage {
            transforms: vec![TransformStamped {
                header: header(1),
                ..TransformStamped::default()
            }],
        };
        let bytes = Bytes::from(cdr::to_bytes(&message).unwrap());
        let moved = place.restamp(&bytes, |_| i64::MAX);
        assert!(matches!(moved, Err(RestampError::OutOfRange(i64::MAX))));
    }

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
        assert!(matches!(
            restamp(&Bytes::from_static(&[0, 1, 0, 0, 1]), |s| s),
            Err(RestampError::TooShort(5))
        ));
        let parameter_list = Bytes::from_static(&[0, 3, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert!(matches!(
            restamp(&parameter_list, |s| s),
            Err(RestampError::Encapsulation(3))
        ));
        let plain = Bytes::from_static(&[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert!(matches!(
            restamp(&plain, |_| i64::MAX),
            Err(RestampError::OutOfRange(i64::MAX))
        ));
    }

    #[test]
    fn a_second_of_nanoseconds_is_not_moved() {
        let malformed = Bytes::from_static(&[0, 1, 0, 0, 5, 0, 0, 0, 255, 255, 255, 255]);
        let moved = restamp(&malformed, |stamp| stamp);
        assert!(
            matches!(moved, Err(RestampError::Malformed(_))),
            "{moved:?}"
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
