//! A folder for targets that read files.

use std::path::PathBuf;
use tempfile::TempDir;

/// A folder per thread, reused by all runs: creating one takes longer than most runs.
///
/// # Panics
/// The folder cannot be created.
#[allow(
    clippy::expect_used,
    reason = "without a folder there is nothing to fuzz"
)]
pub(crate) fn folder(name: &str) -> PathBuf {
    thread_local! {
        static FOLDER: TempDir = TempDir::new().expect("a temporary folder");
    }
    let folder = FOLDER.with(|folder| folder.path().join(name));
    std::fs::create_dir_all(&folder).expect("a folder within the temporary folder");
    folder
}

/// Writes `data` to `file` in [`folder`]`(name)`; returns its path.
///
/// # Panics
/// The file cannot be written.
#[allow(
    clippy::expect_used,
    reason = "without a file there is nothing to fuzz"
)]
pub(crate) fn file(name: &str, file: &str, data: &[u8]) -> PathBuf {
    let path = folder(name).join(file);
    std::fs::write(&path, data).expect("room for a file");
    path
}
