use std::time::{Duration, UNIX_EPOCH};

/// Before the first retry.
const FIRST: Duration = Duration::from_secs(1);
/// A server that restarts loads a model for longer than any shorter sum of waits.
const LONGEST: Duration = Duration::from_secs(60);
/// Limit of `Retry-After`. A longer wait means a quota that is used up for the day: better to come back later.
pub(super) const MAX_RETRY_AFTER: Duration = Duration::from_secs(600);

/// How long to wait before retry `retry`, counted from 0, if the server does not say: doubled each time, and between half of
/// that and all of it, so that clients that failed together do not come back together. `seed` decides where between, so
/// that a run is repeatable.
pub(super) fn delay(retry: u32, seed: u64) -> Duration {
    let doubled = FIRST.saturating_mul(2_u32.saturating_pow(retry));
    // 32 bits are exact in f64.
    let fraction = f64::from((mix(seed ^ u64::from(retry)) >> 32) as u32) / 2_f64.powi(32);
    doubled.min(LONGEST).mul_f64(0.5 + fraction / 2.0)
}

/// The wait of a `Retry-After` header: seconds, or a date.
pub(super) fn retry_after(header: &str, now_unix_s: u64) -> Option<Duration> {
    let header = header.trim();
    let until_date = || {
        let date = httpdate::parse_http_date(header).ok()?;
        let unix_s = date.duration_since(UNIX_EPOCH).ok()?.as_secs();
        Some(unix_s.saturating_sub(now_unix_s))
    };
    let seconds = header.parse().ok().or_else(until_date);
    seconds.map(Duration::from_secs)
}

/// The last step of SplitMix64, which makes neighbours differ in half of their bits.
fn mix(seed: u64) -> u64 {
    let z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_double_and_stay_in_bounds() {
        for seed in 0..100 {
            for (retry, full) in [(0, 1), (1, 2), (5, 32), (6, 60), (31, 60), (u32::MAX, 60)] {
                let full = Duration::from_secs(full);
                let delay = delay(retry, seed);
                assert!(delay >= full / 2 && delay <= full, "{retry}: {delay:?}");
            }
        }
        assert_eq!(delay(3, 7), delay(3, 7));
        assert_ne!(delay(3, 7), delay(3, 8));
    }

    #[test]
    fn retry_after_is_seconds_or_a_date() {
        let seconds = |header| retry_after(header, 784_111_770).map(|d| d.as_secs());
        assert_eq!(seconds(" 17 "), Some(17));
        assert_eq!(seconds("Sun, 06 Nov 1994 08:49:37 GMT"), Some(7));
        assert_eq!(seconds("Sunday, 06-Nov-94 08:49:37 GMT"), Some(7));
        assert_eq!(seconds("Sun, 06 Nov 1994 08:49:00 GMT"), Some(0));
        assert_eq!(seconds("Sun, 06 Nov 1994 08:49:37 CET"), None);
        assert_eq!(seconds("Sun, 32 Nov 1994 08:49:37 GMT"), None);
        assert_eq!(seconds("-1"), None);
        assert_eq!(seconds("later"), None);
    }
}
