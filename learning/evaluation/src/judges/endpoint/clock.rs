use std::{
    fmt::Debug,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

/// Time and waiting. Tests use a clock that never waits.
pub trait Clock: Debug + Send + Sync {
    /// Monotonic time since an arbitrary origin.
    fn now(&self) -> Duration;

    /// Seconds since 1970, for dates of servers.
    fn unix_s(&self) -> u64;

    /// Waits for a duration.
    fn sleep(&self, duration: Duration);
}

/// The system clock.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock(Instant);

impl Default for SystemClock {
    fn default() -> Self {
        Self(Instant::now())
    }
}

impl Clock for SystemClock {
    fn now(&self) -> Duration {
        self.0.elapsed()
    }

    fn unix_s(&self) -> u64 {
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        since.map_or(0, |since| since.as_secs())
    }

    fn sleep(&self, duration: Duration) {
        std::thread::sleep(duration);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::sync::Mutex;

    use super::*;

    /// Sleeping advances it.
    #[derive(Debug, Default)]
    pub(crate) struct FakeClock(Mutex<Duration>);

    impl Clock for FakeClock {
        fn now(&self) -> Duration {
            *self.0.lock().unwrap()
        }

        fn unix_s(&self) -> u64 {
            self.now().as_secs()
        }

        fn sleep(&self, duration: Duration) {
            *self.0.lock().unwrap() += duration;
        }
    }

    #[test]
    fn system_clock_advances() {
        let clock = SystemClock::default();
        let before = clock.now();
        clock.sleep(Duration::ZERO);
        // 2020-01-01.
        assert!(clock.now() >= before && clock.unix_s() > 1_577_836_800);
    }
}
