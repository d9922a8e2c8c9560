//! Stamps of messages.

use wm_msgs::builtin_interfaces::Time;

use super::HistoryError;

/// Clocks of machines that are not synchronised well differ by less \[ns\].
const CLOCKS_DIFFER_NS: i64 = 10_000_000_000;

/// A message's stamp in nanoseconds.
pub(super) fn stamp_of(what: &'static str, stamp: Time, now: Time) -> Result<i64, HistoryError> {
    if stamp.sec < 0 || stamp.nanosec >= 1_000_000_000 {
        return Err(HistoryError::Stamp {
            what,
            sec: stamp.sec,
            nanosec: stamp.nanosec,
        });
    }
    let (stamp_ns, now_ns) = (stamp.to_nanos(), now.to_nanos());
    // A node that waits for /clock has no time yet.
    if now_ns > 0 && stamp_ns > now_ns.saturating_add(CLOCKS_DIFFER_NS) {
        let ahead_s = (stamp_ns - now_ns) as f64 / 1e9;
        return Err(HistoryError::Future { what, ahead_s });
    }
    Ok(stamp_ns)
}

/// A stamp as people read it.
pub fn seconds(stamp: Time) -> String {
    format!("{}.{:09} s", stamp.sec, stamp.nanosec)
}

pub(super) fn seconds_of(stamp_ns: i64) -> String {
    seconds(Time::from_nanos(stamp_ns))
}
