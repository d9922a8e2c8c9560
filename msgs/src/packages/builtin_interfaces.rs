//! Package `builtin_interfaces`: points in time and spans of it.

use serde::{Deserialize, Serialize};

/// Nanoseconds of a second.
const NANOS: i64 = 1_000_000_000;

/// A point in time: seconds since the clock's epoch and nanoseconds onwards from there.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Time {
    /// Whole seconds \[s\], rounded towards the past.
    pub sec: i32,
    /// Nanoseconds after `sec` \[ns\], 0 to 999 999 999.
    pub nanosec: u32,
}

/// A span of time, negative ones included.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Duration {
    /// Whole seconds \[s\], rounded towards minus infinity.
    pub sec: i32,
    /// Nanoseconds after `sec` \[ns\], 0 to 999 999 999.
    pub nanosec: u32,
}

/// Splits nanoseconds; what a signed 32-bit second cannot hold saturates at its ends.
fn split(nanos: i64) -> (i32, u32) {
    match i32::try_from(nanos.div_euclid(NANOS)) {
        // The remainder is below 10^9, which a u32 holds.
        Ok(sec) => (sec, nanos.rem_euclid(NANOS) as u32),
        Err(_) if nanos < 0 => (i32::MIN, 0),
        Err(_) => (i32::MAX, 999_999_999),
    }
}

/// Nanoseconds, if `nanosec` is below one second.
fn checked(sec: i32, nanosec: u32) -> Option<i64> {
    (i64::from(nanosec) < NANOS).then(|| join(sec, nanosec))
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

    /// Nanoseconds since the epoch.
    pub fn to_nanos(self) -> i64 {
        join(self.sec, self.nanosec)
    }

    /// Nanoseconds since the epoch; `None` if the time is malformed: `nanosec` is a second or more.
    pub fn checked_nanos(self) -> Option<i64> {
        checked(self.sec, self.nanosec)
    }
}

impl Duration {
    /// From nanoseconds; spans beyond 32-bit seconds saturate.
    pub fn from_nanos(nanos: i64) -> Self {
        let (sec, nanosec) = split(nanos);
        Self { sec, nanosec }
    }

    /// The span in nanoseconds.
    pub fn to_nanos(self) -> i64 {
        join(self.sec, self.nanosec)
    }

    /// The span in nanoseconds; `None` if it is malformed: `nanosec` is a second or more.
    pub fn checked_nanos(self) -> Option<i64> {
        checked(self.sec, self.nanosec)
    }
}

message!(
    Time,
    "builtin_interfaces",
    "int32 sec\nuint32 nanosec\n",
    []
);
message!(
    Duration,
    "builtin_interfaces",
    "int32 sec\nuint32 nanosec\n",
    []
);

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_negative_span_has_nanoseconds_that_count_forwards() {
        assert_eq!(
            Duration::from_nanos(-1),
            Duration {
                sec: -1,
                nanosec: 999_999_999
            }
        );
    }

    #[test]
    fn what_seconds_cannot_hold_saturates() {
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
    fn nanosec_of_a_second_or_more_is_malformed() {
        let (sec, nanosec) = (5, 999_999_999);
        assert_eq!(Time { sec, nanosec }.checked_nanos(), Some(5_999_999_999));
        assert_eq!(
            Duration { sec, nanosec }.checked_nanos(),
            Some(5_999_999_999)
        );
        for nanosec in [1_000_000_000, 1_999_999_999, u32::MAX] {
            assert_eq!(Time { sec, nanosec }.checked_nanos(), None);
            assert_eq!(Duration { sec, nanosec }.checked_nanos(), None);
        }
    }

    proptest! {
        #[test]
        fn nanoseconds_survive(sec in any::<i32>(), nanosec in 0u32..1_000_000_000) {
            let time = Time { sec, nanosec };
            prop_assert_eq!(Time::from_nanos(time.to_nanos()), time);
        }
    }
}
