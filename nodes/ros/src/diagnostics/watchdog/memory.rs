//! The process's resident memory, which must not grow once the node works.

use super::{Finding, Level};
use std::time::{Duration, Instant};

/// How long the memory of a node that has begun to work may grow: caches and pools fill.
const SETTLING: Duration = Duration::from_secs(30);
const MIB: u64 = 1 << 20;
/// Growth by half, and by at least this, is a warning: allocators and queues take some.
const WARN_LEAST: u64 = 64 * MIB;
/// Growth to the double, and by at least this, is an error.
const ERROR_LEAST: u64 = 256 * MIB;

#[derive(Debug, Default)]
pub(super) struct MemoryWatch {
    since: Option<Instant>,
    /// The maximum during the settling time \[byte\].
    settled: u64,
}

impl MemoryWatch {
    pub(super) fn judge(&mut self, now: Instant, resident: u64) -> Finding {
        let since = *self.since.get_or_insert(now);
        let age = now.saturating_duration_since(since);
        if age <= SETTLING {
            self.settled = self.settled.max(resident);
        }
        let growth = resident.saturating_sub(self.settled);
        let level = if growth > self.settled + ERROR_LEAST {
            Level::Error
        } else if growth > self.settled / 2 + WARN_LEAST {
            Level::Warn
        } else {
            Level::Ok
        };
        let message = match level {
            Level::Ok => format!("{} MiB resident", resident / MIB),
            _ => format!(
                "{} MiB resident, up from {} MiB {:.0} min ago: a subscriber may be too slow, or memory leaks; check \
                 the drops above, and restart the node before memory runs out",
                resident / MIB,
                self.settled / MIB,
                age.as_secs_f64() / 60.0
            ),
        };
        Finding {
            subject: "memory".to_owned(),
            level,
            message,
        }
    }
}

/// The resident memory of this process \[byte\] on Linux; `None` elsewhere.
pub(in crate::diagnostics) fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib.saturating_mul(1024))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_counts_from_where_it_settled() {
        let (mut watch, start) = (MemoryWatch::default(), Instant::now());
        let mut level = |seconds, mib| {
            let now = start + Duration::from_secs(seconds);
            watch.judge(now, mib * MIB).level
        };
        assert_eq!(level(0, 20), Level::Ok);
        assert_eq!(level(20, 100), Level::Ok, "the weights are loaded");
        assert_eq!(level(60, 214), Level::Ok);
        assert_eq!(level(61, 215), Level::Warn);
        assert_eq!(level(62, 456), Level::Warn);
        assert_eq!(level(63, 457), Level::Error);
        assert_eq!(level(64, 90), Level::Ok);
    }

    #[test]
    fn this_process_has_memory() {
        let resident = resident().unwrap();
        assert!(resident > MIB && resident < 1 << 36, "{resident}");
    }
}
