//! Stamps of messages from other machines.

/// A stamp of the present may be this far ahead of a node's clock: clocks of machines in step differ by less \[ns\].
pub const AHEAD_NS: i64 = 100_000_000;
