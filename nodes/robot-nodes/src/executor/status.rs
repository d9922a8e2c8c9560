//! The executor's status.

use std::time::Duration;

/// Longest time from one published status to the next.
pub(super) const STATUS_PERIOD: Duration = Duration::from_secs(1);

/// The executor's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Not armed: nothing is sent.
    DryRun,
    /// Armed, and nothing to do.
    Idle,
    /// Armed, and an offer is executed.
    Executing,
    /// Commands decelerate to zero.
    Stopping,
    /// Emergency stop.
    Stopped,
}

/// The executor's status.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// The state.
    pub state: State,
    /// Why the arm does not move, or moves differently from its offer; empty if it moves as offered.
    pub reason: String,
    /// One word for a missing condition of motion.
    pub hold: Option<&'static str>,
    /// Stamp of the offer that is executed \[ns\].
    pub offer_ns: Option<i64>,
    /// Totals.
    pub counts: Counts,
}

/// Totals since the node's start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Offers that were begun.
    pub begun: u64,
    /// Offers that were refused, at once or after waiting.
    pub refused: u64,
    /// Offers that were vetoed.
    pub vetoed: u64,
    /// Offers that were cut short.
    pub interrupted: u64,
}
