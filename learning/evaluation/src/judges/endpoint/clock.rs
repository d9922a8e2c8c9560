use std::{
    fmt::Debug,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

/// What time it is, and waiting. Tests have one of their own that waits for nothing.
pub trait Clock: Debug + Send + Sync {
    /// Time since some moment; never goes back.
    fn now(&self) -> Duration;

    /// Seconds since 1970, for dates that a server states.
    fn unix_s(&self) -> u64;

    /// Waits.
    fn sleep(&self, duration: Duration);
}

/// The computer's clock.
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

    /// Sleeping moves it on.
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
    fn the_system_knows_the_time() {
        let clock = SystemClock::default();
        let before = clock.now();
        clock.sleep(Duration::ZERO);
        // 2020-01-01.
        assert!(clock.now() >= before && clock.unix_s() > 1_577_836_800);
    }
}
