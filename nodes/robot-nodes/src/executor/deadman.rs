//! The deadman switch.

use std::time::{Duration, Instant};

use super::Hold;

/// The deadman switch: a person holds it while the arm may move.
#[derive(Clone, Debug)]
pub struct Deadman {
    timeout: Duration,
    last: Option<(bool, Instant)>,
}

impl Deadman {
    /// A switch that must report every `timeout` that it is held.
    pub fn new(timeout: Duration) -> Self {
        Self {
            timeout,
            last: None,
        }
    }

    /// Takes a report of the switch, received at `at`.
    pub fn set(&mut self, is_held: bool, at: Instant) {
        self.last = Some((is_held, at));
    }

    /// Checks that it is held.
    ///
    /// # Errors
    /// [`Hold`] says why the arm may not move.
    pub fn check(&self, now: Instant) -> Result<(), Hold> {
        match self.last {
            None => Err(Hold::NoDeadman),
            Some((false, _)) => Err(Hold::DeadmanReleased),
            Some((true, at)) if now.saturating_duration_since(at) > self.timeout => {
                Err(Hold::DeadmanSilent {
                    timeout_s: self.timeout.as_secs_f64(),
                })
            }
            Some((true, _)) => Ok(()),
        }
    }
}
