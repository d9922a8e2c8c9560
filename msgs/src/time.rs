//! Arithmetic and checks of times and spans. Decoding refuses a time whose nanoseconds are a second or more.

use crate::builtin_interfaces::{Duration, Time};
use serde::Deserialize;
use thiserror::Error;

/// Nanoseconds in a second.
const NANOS: i64 = 1_000_000_000;

/// A time or span whose nanoseconds are a second or more.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("{sec} s and {nanosec} ns: expected less than 1e9 ns")]
pub struct InvalidNanoseconds {
    /// Its seconds.
    pub sec: i32,
    /// Its nanoseconds.
    pub nanosec: u32,
}

/// A time from a peer or a bag. serde names it as the message.
#[derive(Deserialize)]
#[serde(rename = "Time")]
pub(crate) struct UncheckedTime {
    sec: i32,
    nanosec: u32,
}

/// A span from a peer or a bag.
#[derive(Deserialize)]
#[serde(rename = "Duration")]
pub(crate) struct UncheckedDuration {
    sec: i32,
    nanosec: u32,
}

/// Splits nanoseconds; beyond signed 32-bit seconds they saturate.
fn split(nanos: i64) -> (i32, u32) {
    match i32::try_from(nanos.div_euclid(NANOS)) {
        // The remainder is below 10^9, which a u32 holds.
        Ok(sec) => (sec, nanos.rem_euclid(NANOS) as u32),
        Err(_) if nanos < 0 => (i32::MIN, 0),
        Err(_) => (i32::MAX, 999_999_999),
    }
}

impl TryFrom<UncheckedTime> for Time {
    type Error = InvalidNanoseconds;

    fn try_from(UncheckedTime { sec, nanosec }: UncheckedTime) -> Result<Self, InvalidNanoseconds> {
        checked(sec, nanosec).map(|_| Self { sec, nanosec })
    }
}

impl TryFrom<UncheckedDuration> for Duration {
    type Error = InvalidNanoseconds;

    fn try_from(
        UncheckedDuration { sec, nanosec }: UncheckedDuration,
    ) -> Result<Self, InvalidNanoseconds> {
        checked(sec, nanosec).map(|_| Self { sec, nanosec })
    }
}

fn checked(sec: i32, nanosec: u32) -> Result<i64, InvalidNanoseconds> {
    match i64::from(nanosec) < NANOS {
        true => Ok(join(sec, nanosec)),
        false => Err(InvalidNanoseconds { sec, nanosec }),
    }
}

/// Cannot overflow: 2^31 s x 10^9 + 2^32 ns < 2^63 ns.
fn join(sec: i32, nanosec: u32) -> i64 {
    i64::from(sec) * NANOS + i64::from(nanosec)
}

impl Time {
    /// From nanoseconds since the epoch; times beyond 32-bit seconds saturate.
    pub fn from_nanos(nanos: i64) -> Self {
        let (sec, nanosec) = split(nanos);
        Self { sec, nanosec }
    }

    /// Nanoseconds since the epoch, checked: a message from a node of the same process is not decoded.
    ///
    /// # Errors
    /// [`InvalidNanoseconds`].
    pub fn checked_nanos(self) -> Result<i64, InvalidNanoseconds> {
        checked(self.sec, self.nanosec)
    }

    /// Nanoseconds since the epoch. The time must be decoded or built by [`from_nanos`](Self::from_nanos).
    pub fn to_nanos(self) -> i64 {
        join(self.sec, self.nanosec)
    }
}

impl Duration {
    /// From nanoseconds; spans beyond 32-bit seconds saturate.
    pub fn from_nanos(nanos: i64) -> Self {
        let (sec, nanosec) = split(nanos);
        Self { sec, nanosec }
    }

    /// The span in nanoseconds, checked: a message from a node of the same process is not decoded.
    ///
    /// # Errors
    /// [`InvalidNanoseconds`].
    pub fn checked_nanos(self) -> Result<i64, InvalidNanoseconds> {
        checked(self.sec, self.nanosec)
    }

    /// The span in nanoseconds. It must be decoded or built by [`from_nanos`](Self::from_nanos).
    pub fn to_nanos(self) -> i64 {
        join(self.sec, self.nanosec)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{cdr, std_msgs::Header};
    use proptest::prelude::*;

    #[test]
    fn nanoseconds_of_negative_spans_count_forwards() {
        assert_eq!(
            Duration::from_nanos(-1),
            Duration {
                sec: -1,
                nanosec: 999_999_999
            }
        );
    }

    #[test]
    fn times_beyond_32_bit_seconds_saturate() {
        assert_eq!(
            Time::from_nanos(i64::MAX),
            Time {
                sec: i32::MAX,
                nanosec: 999_999_999
            }
        );
        assert_eq!(
            Time::from_nanos(i64::MIN),
            Time {
                sec: i32::MIN,
                nanosec: 0
            }
        );
    }

    #[test]
    fn a_second_of_nanoseconds_is_malformed() {
        for nanosec in [1_000_000_000, 1_999_999_999, u32::MAX] {
            let expected = Err(InvalidNanoseconds { sec: 5, nanosec });
            assert_eq!(Time { sec: 5, nanosec }.checked_nanos(), expected);
            assert_eq!(Duration { sec: 5, nanosec }.checked_nanos(), expected);
        }
        let last = Time {
            sec: 5,
            nanosec: 999_999_999,
        };
        assert_eq!(last.checked_nanos(), Ok(5_999_999_999));
    }

    #[test]
    fn decoding_refuses_a_second_of_nanoseconds() {
        for nanosec in [1_000_000_000, 1_999_999_999, u32::MAX] {
            let header = Header {
                stamp: Time { sec: 5, nanosec },
                frame_id: "camera".into(),
            };
            let bytes = cdr::to_bytes(&header).unwrap();
            let error = cdr::from_bytes::<Header>(&bytes).unwrap_err().to_string();
            let expected = format!("5 s and {nanosec} ns: expected less than 1e9 ns");
            assert!(error.contains(&expected), "{error}");
            let bytes = cdr::to_bytes(&Duration { sec: 5, nanosec }).unwrap();
            assert!(cdr::from_bytes::<Duration>(&bytes).is_err());
        }
    }

    proptest! {
        #[test]
        fn decoded_times_are_valid(sec in any::<i32>(), nanosec in any::<u32>()) {
            let time = Time { sec, nanosec };
            let decoded = cdr::from_bytes::<Time>(&cdr::to_bytes(&time).unwrap());
            prop_assert_eq!(decoded.ok(), time.checked_nanos().ok().map(|_| time));
        }

        #[test]
        fn nanoseconds_survive(sec in any::<i32>(), nanosec in 0u32..1_000_000_000) {
            let time = Time { sec, nanosec };
            prop_assert_eq!(Time::from_nanos(time.to_nanos()), time);
        }
    }
}
