//! Main memory.

use crate::{DoctorError, Finding, control_group::ControlGroups, system_file::read};

const CHECK: &str = "memory";
/// Encoder, predictor, decoder and planner use up to 180 MiB each with the bundled model (docs/benchmarks.md);
/// recorder, monitor and the queues of slow subscribers need more \[byte\].
const LEAST: u64 = 1 << 30;

/// Memory available to this process.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Memory {
    /// Of the machine \[byte\].
    pub total: u64,
    /// Unused memory of the machine \[byte\].
    pub available: u64,
    /// Limit and use of the control group \[byte\].
    pub group: Option<(u64, u64)>,
}

impl Memory {
    pub(crate) fn look() -> Result<Self, DoctorError> {
        Ok(Self {
            group: ControlGroups::look().and_then(|groups| groups.memory()),
            ..Self::of_meminfo(&read("/proc/meminfo")?)
        })
    }

    /// From the text of `/proc/meminfo`.
    fn of_meminfo(text: &str) -> Self {
        let bytes = |key: &str| {
            let line = text.lines().find_map(|line| line.strip_prefix(key));
            let kib: Option<u64> =
                line.and_then(|line| line.trim().strip_suffix(" kB")?.parse().ok());
            kib.unwrap_or(0).saturating_mul(1024)
        };
        Self {
            total: bytes("MemTotal:"),
            available: bytes("MemAvailable:"),
            group: None,
        }
    }

    /// Memory that this process can still use \[byte\].
    pub(crate) fn usable(&self) -> u64 {
        let left = self.group.map(|(limit, taken)| limit.saturating_sub(taken));
        self.available.min(left.unwrap_or(u64::MAX))
    }
}

pub(crate) fn gib(bytes: u64) -> String {
    format!("{:.1} GiB", bytes as f64 / f64::from(1 << 30))
}

pub(crate) fn check(memory: &Memory) -> Vec<Finding> {
    let usable = memory.usable();
    let of = match memory.group {
        Some((limit, _)) => format!("the {} limit of this process", gib(limit)),
        None => gib(memory.total),
    };
    let what = format!("{} free, of {of}", gib(usable));
    vec![match usable < LEAST {
        false => Finding::ok(CHECK, what),
        true => Finding::warning(CHECK, what)
            .because("encoder, predictor, decoder and planner take up to 180 MiB each with the bundled model, and more with others; the kernel kills a node without memory")
            .fix("end other programs, raise the limit (MemoryMax of systemd, docker --memory), or run the nodes in one process: one_process:=true"),
    }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Level;

    #[test]
    fn smaller_memory_limit_counts() {
        let text = "MemTotal:        8388608 kB\nMemFree: 1 kB\nMemAvailable:    4194304 kB\n";
        let mut memory = Memory::of_meminfo(text);
        assert_eq!((memory.total, memory.usable()), (8 << 30, 4 << 30));
        assert_eq!(check(&memory)[0].level, Level::Ok);
        memory.group = Some((2 << 30, 3 << 29));
        assert_eq!(memory.usable(), 1 << 29);
        let finding = &check(&memory)[0];
        assert_eq!(finding.level, Level::Warning);
        assert_eq!(
            finding.what,
            "0.5 GiB free, of the 2.0 GiB limit of this process"
        );
    }
}
