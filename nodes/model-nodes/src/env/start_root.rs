//! The files that a call may name as the start of an episode.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result};

use super::{EnvError, Start};

/// The folder of the bags and images that a call may name. Any node in the ROS graph can call: the rest of the disk must not
/// show in the answers, and a pipe or a device must not block the env.
#[derive(Clone, Debug, Default)]
pub struct StartRoot {
    /// Canonical; `None`: no file may be named.
    folder: Option<PathBuf>,
}

impl StartRoot {
    /// The folder. If it is empty or the root of the file system, a call may name no file.
    ///
    /// # Errors
    /// There is no such folder.
    pub fn new(folder: &str) -> Result<Self> {
        if folder.is_empty() {
            return Ok(Self::default());
        }
        let folder = fs::canonicalize(folder)
            .with_context(|| format!("parameter \"start_root\": folder {folder:?}"))?;
        if folder == Path::new("/") {
            tracing::warn!("start_root is /: calls may not name any bag or image");
            return Ok(Self::default());
        }
        Ok(Self {
            folder: Some(folder),
        })
    }

    /// The start with its path resolved, if it is one that a call may name.
    ///
    /// # Errors
    /// [`EnvError::NoStart`], whatever the reason.
    pub fn admit(&self, start: Start) -> Result<Start, EnvError> {
        match start {
            Start::Bag { path, offset_s } => {
                let path = self.resolve(&path, is_bag).ok_or(EnvError::NoStart)?;
                Ok(Start::Bag { path, offset_s })
            }
            Start::Image(path) => {
                let path = self.resolve(&path, is_regular);
                path.map(Start::Image).ok_or(EnvError::NoStart)
            }
            other => Ok(other),
        }
    }

    fn resolve(&self, path: &Path, is_right: fn(&Path) -> bool) -> Option<PathBuf> {
        let folder = self.folder.as_ref()?;
        // Symbolic links and ".." are followed first, so that neither leads out.
        let path = folder.join(path).canonicalize().ok()?;
        (path.starts_with(folder) && is_right(&path)).then_some(path)
    }
}

/// Whether this is a regular file: no link, and nothing that could block.
fn is_regular(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|found| found.is_file())
}

/// A folder of files only, or one file.
fn is_bag(path: &Path) -> bool {
    match fs::read_dir(path) {
        Ok(mut entries) => entries.all(|entry| entry.is_ok_and(|entry| is_regular(&entry.path()))),
        Err(_) => is_regular(path),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{CWD, FileType, Mode, mknodat};
    use std::os::unix::fs::symlink;

    #[test]
    fn a_call_can_name_only_regular_files_below_the_root() {
        let scratch = tempfile::tempdir().unwrap();
        let (root, outside) = (scratch.path().join("root"), scratch.path().join("outside"));
        for folder in [
            &root.join("bag"),
            &root.join("odd"),
            &root.join("linked"),
            &outside,
        ] {
            fs::create_dir_all(folder).unwrap();
            fs::write(folder.join("a.mcap"), "x").unwrap();
        }
        fs::write(root.join("a.png"), "x").unwrap();
        symlink(outside.join("a.mcap"), root.join("out")).unwrap();
        symlink(&outside, root.join("folder")).unwrap();
        symlink(root.join("a.png"), root.join("in")).unwrap();
        symlink(outside.join("a.mcap"), root.join("linked/b.mcap")).unwrap();
        let fifo = |name: &str| {
            mknodat(
                CWD,
                root.join(name),
                FileType::Fifo,
                Mode::RUSR | Mode::WUSR,
                0,
            )
            .unwrap();
        };
        fifo("pipe");
        fifo("odd/metadata.yaml");

        let admitted =
            |root: &StartRoot, start: Start| root.admit(start).map_err(|e| e.to_string());
        let image = |path: &str| Start::Image(path.into());
        let bag = |path: &str| Start::Bag {
            path: path.into(),
            offset_s: 0.0,
        };
        let starts = StartRoot::new(root.to_str().unwrap()).unwrap();
        let whole = root.join("a.png");
        for path in ["a.png", "in", "bag/../a.png", whole.to_str().unwrap()] {
            assert!(admitted(&starts, image(path)).is_ok(), "{path}");
        }
        for path in ["bag", "bag/a.mcap", "bag/"] {
            assert!(admitted(&starts, bag(path)).is_ok(), "{path}");
        }
        let uniform = EnvError::NoStart.to_string();
        let images = [
            "pipe",
            "out",
            "folder/a.mcap",
            "bag",
            "none.png",
            "",
            "../outside/a.mcap",
            "/etc/shadow",
            "/etc/passwd",
            "/dev/zero",
            "/proc/self/environ",
            "/none",
        ];
        for path in images {
            assert_eq!(
                admitted(&starts, image(path)).unwrap_err(),
                uniform,
                "{path}"
            );
        }
        for path in [
            "pipe",
            "odd",
            "linked",
            "folder",
            "none",
            "..",
            "../outside",
            "/etc",
            "/dev",
        ] {
            assert_eq!(admitted(&starts, bag(path)).unwrap_err(), uniform, "{path}");
        }
        for closed in ["", "/"] {
            let closed = StartRoot::new(closed).unwrap();
            assert_eq!(
                admitted(&closed, image("/etc/passwd")).unwrap_err(),
                uniform
            );
        }
        assert!(StartRoot::new("/no/such/folder").is_err());
    }
}
