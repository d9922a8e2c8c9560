//! The ROS installation of `AMENT_PREFIX_PATH`, else that of `tests/setup_ros2` for `WM_TEST_ROS_DISTRO`.

use std::path::{Path, PathBuf};

pub struct Installation {
    prefixes: Vec<PathBuf>,
}

impl Installation {
    /// The installation; `None`, with a message, if none is found.
    pub fn find() -> Option<Self> {
        let distribution =
            std::env::var("WM_TEST_ROS_DISTRO").unwrap_or_else(|_| "kilted".to_owned());
        let made = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.venv"))
            .join(format!("ros2-{distribution}"));
        let prefixes: Vec<PathBuf> = match std::env::var_os("AMENT_PREFIX_PATH") {
            Some(path) => std::env::split_paths(&path).collect(),
            None => vec![made.clone(), made.join("ws/install")],
        };
        if prefixes.iter().any(|prefix| prefix.join("share").is_dir()) {
            return Some(Self { prefixes });
        }
        eprintln!(
            "skipped: no ROS 2 on AMENT_PREFIX_PATH or under .venv; run tests/setup_ros2 (tests/run does)"
        );
        assert!(
            std::env::var_os("CI").is_none(),
            "comparisons with ROS 2 may not be skipped in CI"
        );
        None
    }

    /// The file of a type, `package/msg/Type` for example; `None`, with a message, if it is missing.
    pub fn read(&self, ros_name: &str, extension: &str) -> Option<String> {
        let file = format!("share/{ros_name}.{extension}");
        let found = self
            .prefixes
            .iter()
            .find_map(|prefix| std::fs::read_to_string(prefix.join(&file)).ok());
        if found.is_none() {
            eprintln!("skipped {ros_name}: no prefix has {file}");
        }
        found
    }
}
