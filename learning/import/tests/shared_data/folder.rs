use std::path::PathBuf;

/// A data set in the directory that the environment variable WM_SHARED_DATA names. Without it, the test says so and passes.
pub fn shared(name: &str) -> Option<PathBuf> {
    let found = std::env::var_os("WM_SHARED_DATA")
        .map(|dir| PathBuf::from(dir).join(name))
        .filter(|dir| dir.is_dir());
    if found.is_none() {
        eprintln!("skipped: set WM_SHARED_DATA to a directory with {name}/ in it");
    }
    found
}
