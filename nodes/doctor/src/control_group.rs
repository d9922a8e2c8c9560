//! The control groups (version 2) of this process: its own, and those around it, whose limits hold as well.

use crate::system_file::read_if_there;
use std::path::{Path, PathBuf};

/// Folders of the control groups, from the process's own to the outermost.
pub(crate) struct ControlGroups(Vec<PathBuf>);

/// How much processor time the processes of a control group get.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Quota {
    /// Processor seconds per second.
    pub processors: f64,
    /// Periods in which the processes used their share and were stopped until its end.
    pub throttled: u64,
}

impl ControlGroups {
    /// `None` where the kernel has no control groups of version 2.
    pub(crate) fn look() -> Option<Self> {
        Self::of(
            &read_if_there("/proc/self/cgroup")?,
            Path::new("/sys/fs/cgroup"),
        )
    }

    /// From the text of `/proc/PID/cgroup`.
    fn of(text: &str, root: &Path) -> Option<Self> {
        let path = text.lines().find_map(|line| line.strip_prefix("0::"))?;
        let own = root.join(path.trim_start_matches('/'));
        let around = own
            .ancestors()
            .take_while(|folder| folder.starts_with(root));
        Some(Self(around.map(Path::to_owned).collect()))
    }

    /// Limit and use of the group with the least memory left \[byte\]; `None` without a limit.
    pub(crate) fn memory(&self) -> Option<(u64, u64)> {
        let limit = |folder: &PathBuf| {
            let figure = |name: &str| read_if_there(folder.join(name))?.parse::<u64>().ok();
            // "max" means no limit
            Some((figure("memory.max")?, figure("memory.current")?))
        };
        let limits = self.0.iter().filter_map(limit);
        limits.min_by_key(|(limit, taken)| limit.saturating_sub(*taken))
    }

    /// The smallest quota; `None` without one.
    pub(crate) fn quota(&self) -> Option<Quota> {
        let quota = |folder: &PathBuf| {
            let text = read_if_there(folder.join("cpu.max"))?;
            let (time, period) = text.split_once(' ')?;
            let processors = time.parse::<f64>().ok()? / period.parse::<f64>().ok()?;
            let counts = read_if_there(folder.join("cpu.stat")).unwrap_or_default();
            let throttled = counts
                .lines()
                .find_map(|line| line.strip_prefix("nr_throttled ")?.parse().ok());
            Some(Quota {
                processors,
                throttled: throttled.unwrap_or(0),
            })
        };
        let quotas = self.0.iter().filter_map(quota);
        quotas.min_by(|a, b| a.processors.total_cmp(&b.processors))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The groups of a process in `robot/wm`, with these files below the root.
    fn groups(files: &[(&str, &str)]) -> (tempfile::TempDir, ControlGroups) {
        let root = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(root.path().join("robot/wm")).unwrap();
        for (name, text) in files {
            std::fs::write(root.path().join(name), text).unwrap();
        }
        let groups = ControlGroups::of("1:x:/y\n0::/robot/wm\n", root.path()).unwrap();
        (root, groups)
    }

    #[test]
    fn group_without_limit_is_ignored() {
        let (_root, unlimited) = groups(&[
            ("robot/wm/memory.max", "max\n"),
            ("robot/wm/memory.current", "1000\n"),
            ("robot/wm/cpu.max", "max 100000\n"),
        ]);
        assert_eq!((unlimited.memory(), unlimited.quota()), (None, None));
        assert!(ControlGroups::of("", Path::new("/sys/fs/cgroup")).is_none());
    }

    #[test]
    fn tightest_group_counts() {
        let (_root, limited) = groups(&[
            ("robot/wm/memory.max", "4096\n"),
            ("robot/wm/memory.current", "1000\n"),
            ("robot/memory.max", "5000\n"),
            ("robot/memory.current", "4000\n"),
            ("robot/wm/cpu.max", "400000 100000\n"),
            ("robot/cpu.max", "150000 100000\n"),
            ("robot/cpu.stat", "nr_periods 9\nnr_throttled 7\n"),
        ]);
        assert_eq!(limited.memory(), Some((5000, 4000)));
        let quota = Quota {
            processors: 1.5,
            throttled: 7,
        };
        assert_eq!(limited.quota(), Some(quota));
    }
}
