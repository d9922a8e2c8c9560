//! Times and numbers of a coordinator.

use std::time::Duration;

/// Times and numbers of a coordinator.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Time for a new connection to say who it is.
    pub greeting: Duration,
    /// Time between two pings of a worker without work.
    pub ping: Duration,
    /// Time for a job, beyond three times the expected one.
    pub patience: Duration,
    /// Time for a trial, for which nothing waits.
    pub trial: Duration,
    /// Time for the last message of a connection.
    pub farewell: Duration,
    /// Most connections.
    pub connections: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            greeting: Duration::from_secs(10),
            ping: Duration::from_secs(5),
            patience: Duration::from_secs(5),
            trial: Duration::from_secs(120),
            farewell: Duration::from_secs(2),
            connections: 64,
        }
    }
}
