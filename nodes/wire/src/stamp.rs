//! Stamps of messages from other machines.

use thiserror::Error;

/// How far a valid stamp may be ahead of a node's clock: synchronised clocks differ by less \[ns\].
pub const AHEAD_NS: i64 = 100_000_000;

/// A stamp in the future.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error(
    "{what} is stamped {ahead_s:.2} s ahead of this node's clock, at most {most_s:.1} s are accepted: synchronise the \
     clocks of the machines, or set use_sim_time on all nodes of a replay"
)]
pub struct FutureStamp {
    /// The message or its part.
    pub what: &'static str,
    /// How far it is ahead \[s\].
    pub ahead_s: f64,
    /// How far it may be ahead \[s\].
    pub most_s: f64,
}

impl FutureStamp {
    /// Refuses a stamp that is more than `most_ns` ahead of the clock, which shows `now_ns` \[ns\].
    ///
    /// # Errors
    /// [`FutureStamp`].
    pub fn refuse(
        what: &'static str,
        stamp_ns: i64,
        now_ns: i64,
        most_ns: i64,
    ) -> Result<(), Self> {
        if stamp_ns <= now_ns.saturating_add(most_ns) {
            return Ok(());
        }
        Err(Self {
            what,
            ahead_s: stamp_ns.saturating_sub(now_ns) as f64 / 1e9,
            most_s: most_ns as f64 / 1e9,
        })
    }
}
