//! Times on the command line.

use std::time::{Duration, UNIX_EPOCH};

/// A duration in seconds.
pub(super) fn parse_seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text
        .parse()
        .map_err(|_| format!("expected a number of seconds, got {text:?}"))?;
    Duration::try_from_secs_f64(seconds).map_err(|error| error.to_string())
}

/// A time in ns since the epoch, from seconds with up to nine decimals, or from a date in UTC.
pub(super) fn parse_stamp_ns(text: &str) -> Result<u64, String> {
    let stamp_ns = if text.contains(['T', '-']) {
        let date = humantime::parse_rfc3339(text).map_err(|error| error.to_string())?;
        date.duration_since(UNIX_EPOCH)
            .ok()
            .and_then(|since| u64::try_from(since.as_nanos()).ok())
    } else {
        decimal_seconds(text)
    };
    stamp_ns.ok_or_else(|| {
        format!("expected seconds since the epoch (1700000000.25) or a date (2023-11-14T22:13:20.25Z), got {text:?}")
    })
}

/// A float, whose 53 bits resolve today's stamps to 200 ns, is too coarse.
fn decimal_seconds(text: &str) -> Option<u64> {
    let (seconds, fraction) = text.split_once('.').unwrap_or((text, "0"));
    let is_number = |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
    if !is_number(seconds) || !is_number(fraction) || fraction.len() > 9 {
        return None;
    }
    let nanoseconds: u64 = format!("{fraction:0<9}").parse().ok()?;
    let seconds: u64 = seconds.parse().ok()?;
    seconds.checked_mul(1_000_000_000)?.checked_add(nanoseconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_exact() {
        for (text, stamp_ns) in [
            ("1700000000", 1_700_000_000_000_000_000),
            ("1700000000.25", 1_700_000_000_250_000_000),
            ("1700000000.000000001", 1_700_000_000_000_000_001),
            ("2023-11-14T22:13:20.25Z", 1_700_000_000_250_000_000),
        ] {
            assert_eq!(parse_stamp_ns(text), Ok(stamp_ns), "{text}");
        }
        for text in [
            "",
            ".5",
            "1.",
            "-1",
            "1e9",
            "99999999999999999999",
            "1.0000000001",
            "nan",
            "T",
        ] {
            assert!(parse_stamp_ns(text).is_err(), "{text}");
        }
    }

    #[test]
    fn spans_are_not_negative() {
        assert_eq!(parse_seconds("1.5"), Ok(Duration::from_millis(1500)));
        for text in ["-1", "nan", "inf", "1s", "1e300"] {
            assert!(parse_seconds(text).is_err(), "{text}");
        }
    }
}
