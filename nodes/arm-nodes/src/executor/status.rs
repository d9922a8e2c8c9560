//! What the executor reports about itself.

/// What the executor does.
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

/// What the executor does, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// What it does.
    pub state: State,
    /// Why it does not move, or not as it was told; empty if it does.
    pub reason: String,
    /// One word for what is missing, if something is.
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
    /// Offers that were refused, those that waited in vain included.
    pub refused: u64,
    /// Offers that were vetoed.
    pub vetoed: u64,
    /// Offers that were cut short.
    pub interrupted: u64,
}
