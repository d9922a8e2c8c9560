//! The system that a launch file reads, behind a trait so that tests need no system.

use std::path::{Path, PathBuf};

/// The files and variables that a launch file reads.
pub trait Surroundings {
    /// An environment variable of the launcher.
    fn environment(&self, name: &str) -> Option<String>;
    /// The text of a file.
    ///
    /// # Errors
    /// See [`std::fs::read_to_string`].
    fn read(&self, path: &Path) -> std::io::Result<String>;
    /// Whether the file or folder exists.
    fn exists(&self, path: &Path) -> bool;

    /// The install prefix of a ROS package: the first folder of `AMENT_PREFIX_PATH` with `share/<package>`.
    fn package_prefix(&self, package: &str) -> Option<PathBuf> {
        let prefixes = self.environment("AMENT_PREFIX_PATH")?;
        let mut prefixes = prefixes
            .split(':')
            .filter(|prefix| !prefix.is_empty())
            .map(PathBuf::from);
        prefixes.find(|prefix| self.exists(&prefix.join("share").join(package)))
    }
}

/// The real system.
#[derive(Clone, Copy, Debug, Default)]
pub struct System;

impl Surroundings for System {
    fn environment(&self, name: &str) -> Option<String> {
        std::env::var(name).ok()
    }

    fn read(&self, path: &Path) -> std::io::Result<String> {
        std::fs::read_to_string(path)
    }

    fn exists(&self, path: &Path) -> bool {
        path.exists()
    }
}
