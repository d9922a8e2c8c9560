//! Stamps of messages from other machines.

/// How far a valid stamp may be ahead of a node's clock: synchronised clocks differ by less \[ns\].
pub const AHEAD_NS: i64 = 100_000_000;
