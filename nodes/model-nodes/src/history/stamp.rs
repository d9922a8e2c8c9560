//! Stamps of messages.

use wm_msgs::{builtin_interfaces::Time, wm_msgs::ActionChunk};

use wm_wire::stamp::{AHEAD_NS, FutureStamp};

use super::{HistoryError, Reception};

/// A policy may announce actions this far ahead; beyond, its clock differs \[ns\].
pub(super) const ANNOUNCED_NS: i64 = 10_000_000_000;

/// The stamp of a received message \[ns\].
///
/// # Errors
/// [`HistoryError::Stamp`].
pub(crate) fn stamp_of_other(what: &'static str, stamp: Time) -> Result<i64, HistoryError> {
    let stamp_ns = stamp.checked_nanos().ok();
    stamp_ns
        .filter(|stamp_ns| *stamp_ns >= 0)
        .ok_or(HistoryError::Stamp {
            what,
            sec: stamp.sec,
            nanosec: stamp.nanosec,
        })
}

/// From one action of a chunk to the next \[ns\].
///
/// # Errors
/// [`HistoryError::Period`].
pub(crate) fn period_of(chunk: &ActionChunk) -> Result<i64, HistoryError> {
    chunk.period.checked_nanos().map_err(HistoryError::Period)
}

/// A message's stamp in nanoseconds, at most `most_ns` ahead of `now`.
pub(super) fn stamp_of(
    what: &'static str,
    stamp: Time,
    now: Time,
    most_ns: i64,
) -> Result<i64, HistoryError> {
    let stamp_ns = stamp_of_other(what, stamp)?;
    let now_ns = now.to_nanos();
    // A node that waits for /clock has no time yet.
    if now_ns > 0 {
        FutureStamp::refuse(what, stamp_ns, now_ns, most_ns)?;
    }
    Ok(stamp_ns)
}

/// The stamp of a frame.
///
/// # Errors
/// [`HistoryError::Stamp`] and [`HistoryError::Future`].
pub(crate) fn stamp_of_frame(stamp: Time, reception: &Reception) -> Result<i64, HistoryError> {
    stamp_of("frame", stamp, reception.latest(), AHEAD_NS)
}

/// A stamp for messages to people.
pub fn seconds(stamp: Time) -> String {
    format!("{}.{:09} s", stamp.sec, stamp.nanosec)
}

pub(super) fn seconds_of(stamp_ns: i64) -> String {
    seconds(Time::from_nanos(stamp_ns))
}
