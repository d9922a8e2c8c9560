//! Stamps of messages.

use wm_msgs::builtin_interfaces::Time;

use super::Problem;

/// If a stamp goes back by less, messages overtook each other; if by more, the clock was set \[ns\].
pub(super) const JUMP_NS: i64 = 100_000_000;

/// The time of a message \[ns\]: its stamp, or its reception if the stamp is zero.
///
/// # Errors
/// [`Problem::Stamp`]: the stamp is invalid.
pub(super) fn stamp_of(what: &'static str, stamp: Time, received_ns: i64) -> Result<i64, Problem> {
    let Time { sec, nanosec } = stamp;
    if sec < 0 || nanosec >= 1_000_000_000 {
        return Err(Problem::Stamp { what, sec, nanosec });
    }
    Ok(match stamp.to_nanos() {
        0 => received_ns,
        stamp_ns => stamp_ns,
    })
}
