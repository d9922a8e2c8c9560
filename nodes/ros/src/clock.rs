//! The node's clock: the system's, or with `use_sim_time` the one on `/clock`.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicI64, Ordering},
    },
    time::{Duration, SystemTime, UNIX_EPOCH},
};
use tokio::sync::watch;
use wm_msgs::builtin_interfaces::Time;

/// A larger step of a simulated clock is a jump \[ns\].
const LONGEST_STEP_NS: i64 = 1_000_000_000;

/// The clock of a node's stamps and timers.
#[derive(Clone, Debug)]
pub struct Clock {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    /// The time on `/clock` \[ns\] if the clock is simulated; 0 until the first message, as in rclcpp.
    simulated: watch::Sender<Option<i64>>,
    jumps: watch::Sender<u64>,
    /// The last step forward on `/clock` \[ns\].
    step_ns: AtomicI64,
    /// Whether an invalid time has been logged.
    has_warned: AtomicBool,
}

impl Clock {
    pub(crate) fn new() -> Self {
        Self {
            inner: Arc::new(Inner {
                simulated: watch::Sender::new(None),
                jumps: watch::Sender::new(0),
                step_ns: AtomicI64::new(0),
                has_warned: AtomicBool::new(false),
            }),
        }
    }

    /// The time now. A simulated clock reads 0 until the first message on `/clock`.
    pub fn now(&self) -> Time {
        Time::from_nanos((*self.inner.simulated.borrow()).unwrap_or_else(system_nanos))
    }

    /// Whether the clock follows `/clock`.
    pub fn is_simulated(&self) -> bool {
        self.inner.simulated.borrow().is_some()
    }

    /// Step of a simulated clock \[ns\], its greatest delay. Zero for the system's clock.
    pub fn step_ns(&self) -> i64 {
        match self.is_simulated() {
            true => self.inner.step_ns.load(Ordering::Relaxed),
            false => 0,
        }
    }

    /// The number of jumps back of `/clock`. A change means that a bag started again: state with older stamps must be
    /// dropped.
    pub fn jumps(&self) -> watch::Receiver<u64> {
        self.inner.jumps.subscribe()
    }

    /// Waits until the clock reads `time`; a jump back makes the wait longer.
    pub async fn sleep_until(&self, time: Time) {
        let wanted = time.to_nanos();
        let mut simulated = self.inner.simulated.subscribe();
        loop {
            let now = *simulated.borrow_and_update();
            let remaining = match now {
                Some(now) if now >= wanted => return,
                Some(_) => None,
                None => match wanted.saturating_sub(system_nanos()) {
                    nanos if nanos <= 0 => return,
                    // positive, so it fits
                    nanos => Some(Duration::from_nanos(nanos.unsigned_abs())),
                },
            };
            // the sender lives in `self`, so `changed` cannot fail
            match remaining {
                None => drop(simulated.changed().await),
                Some(remaining) => {
                    tokio::select! {
                        _ = simulated.changed() => {}
                        () = tokio::time::sleep(remaining) => {}
                    }
                }
            }
        }
    }

    /// Follows `/clock` from now on, or the system's clock again.
    pub(crate) fn set_simulated(&self, is_simulated: bool) {
        self.inner.simulated.send_if_modified(|now| {
            let changes = now.is_some() != is_simulated;
            if changes {
                *now = is_simulated.then_some(0);
            }
            changes
        });
    }

    /// A message of `/clock`.
    pub(crate) fn advance(&self, time: Time) {
        let Ok(nanos) = time.checked_nanos() else {
            if !self.inner.has_warned.swap(true, Ordering::Relaxed) {
                let Time { sec, nanosec } = time;
                tracing::warn!(
                    "skipping invalid times on /clock, the first: {sec} s and {nanosec} ns"
                );
            }
            return;
        };
        let mut jumped = false;
        self.inner.simulated.send_if_modified(|now| match now {
            Some(now) => {
                jumped = nanos < *now;
                let step_ns = nanos.saturating_sub(*now);
                if *now > 0 && (1..=LONGEST_STEP_NS).contains(&step_ns) {
                    self.inner.step_ns.store(step_ns, Ordering::Relaxed);
                }
                *now = nanos;
                true
            }
            None => false,
        });
        if jumped {
            self.inner.jumps.send_modify(|count| *count += 1);
        }
    }
}

/// Nanoseconds since 1970; a clock before that reads 0.
pub(crate) fn system_nanos() -> i64 {
    let since = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(nanos: i64) -> Time {
        Time::from_nanos(nanos)
    }

    #[tokio::test(flavor = "current_thread")]
    async fn a_simulated_clock_wakes_sleepers_and_tells_of_jumps() {
        let clock = Clock::new();
        clock.set_simulated(true);
        assert_eq!(clock.now(), at(0));
        let jumps = clock.jumps();
        let sleeper = tokio::spawn({
            let clock = clock.clone();
            async move {
                clock.sleep_until(at(20)).await;
                clock.now()
            }
        });
        for nanos in [10, 5, 25] {
            clock.advance(at(nanos));
            tokio::task::yield_now().await;
        }
        assert_eq!(sleeper.await.unwrap(), at(25));
        assert_eq!(*jumps.borrow(), 1);
    }

    #[test]
    fn a_simulated_clock_knows_its_step_and_skips_invalid_times() {
        let clock = Clock::new();
        assert_eq!(clock.step_ns(), 0);
        clock.set_simulated(true);
        for nanos in [5_000_000_000, 5_200_000_000, 5_200_000_000] {
            clock.advance(at(nanos));
        }
        assert_eq!(clock.step_ns(), 200_000_000);
        clock.advance(at(60_000_000_000));
        assert_eq!(clock.step_ns(), 200_000_000, "a jump");
        clock.advance(Time {
            sec: 90,
            nanosec: 1_000_000_000,
        });
        assert_eq!(clock.now(), at(60_000_000_000));
        clock.set_simulated(false);
        assert_eq!(clock.step_ns(), 0);
    }

    #[tokio::test(flavor = "current_thread")]
    async fn the_system_clock_ignores_messages_and_sleeps() {
        let clock = Clock::new();
        clock.advance(at(5));
        let wanted = clock.now().to_nanos() + 2_000_000;
        clock.sleep_until(at(wanted)).await;
        assert!(clock.now().to_nanos() >= wanted);
        clock.set_simulated(true);
        clock.set_simulated(false);
        assert!(clock.now().to_nanos() >= wanted);
    }
}
