use std::path::PathBuf;

/// A data set in the folder of the environment variable WM_SHARED_DATA; without it, the test is skipped with a message.
pub fn shared(name: &str) -> Option<PathBuf> {
    let found = std::env::var_os("WM_SHARED_DATA")
        .map(|dir| PathBuf::from(dir).join(name))
        .filter(|dir| dir.is_dir());
    if found.is_none() {
        eprintln!("skipped: set WM_SHARED_DATA to a directory with {name}/ in it");
    }
    found
}
