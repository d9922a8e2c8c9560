//! Whether the computer has room for a training.

use std::path::Path;

/// Degrees below the limit at which a paused training continues.
const COOLER_C: f64 = 5.0;

/// \[bytes\]
pub(super) const GIB: f64 = 1_073_741_824.0;

/// Limits of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Resources {
    /// Greatest temperature of the computer \[°C\].
    pub most_c: f64,
    /// Greatest memory of the process \[bytes\].
    pub most_memory: u64,
    /// Least free space of the disk \[bytes\].
    pub least_free: u64,
}

impl Resources {
    /// Whether a training pauses at this temperature, which differs for one that is paused already.
    pub(super) fn is_too_hot(&self, celsius: f64, is_paused: bool) -> bool {
        let margin = if is_paused { COOLER_C } else { 0.0 };
        celsius > self.most_c - margin
    }
}

/// The highest temperature of the computer's sensors \[°C\]; `None` without a sensor.
pub(super) fn hottest_c() -> Option<f64> {
    let zones = std::fs::read_dir("/sys/class/thermal").ok()?;
    let of_zone = |zone: std::fs::DirEntry| {
        let text = std::fs::read_to_string(zone.path().join("temp")).ok()?;
        // Thousandths of a degree.
        Some(text.trim().parse::<f64>().ok()? / 1000.0)
    };
    zones.flatten().filter_map(of_zone).max_by(f64::total_cmp)
}

/// Memory that a process occupies \[bytes\]; `None` if it has ended.
pub(super) fn memory_of(pid: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: u64 = line.trim().trim_end_matches("kB").trim().parse().ok()?;
    Some(kilobytes * 1024)
}

/// Free space of the disk of a folder \[bytes\].
pub(super) fn free_of(folder: &Path) -> std::io::Result<u64> {
    let disk = rustix::fs::statvfs(folder)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paused_training_waits_until_it_is_cooler() {
        let resources = Resources {
            most_c: 90.0,
            most_memory: 0,
            least_free: 0,
        };
        assert!(!resources.is_too_hot(90.0, false));
        assert!(resources.is_too_hot(90.1, false));
        assert!(resources.is_too_hot(86.0, true));
        assert!(!resources.is_too_hot(85.0, true));
    }

    #[test]
    fn own_memory_and_disk_are_measured() {
        assert!(memory_of(std::process::id()).unwrap() > 1 << 20);
        assert!(memory_of(u32::MAX).is_none());
        assert!(free_of(Path::new("/")).unwrap() > 0);
        assert!(free_of(Path::new("/no/such/folder")).is_err());
    }
}
