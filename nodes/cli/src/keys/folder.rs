//! The folder of keys: nothing in it is overwritten, and only its owner reads it.

use anyhow::{Context as _, Result, bail};
use std::{
    fs::{DirBuilder, OpenOptions},
    io::Write as _,
    os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _},
    path::Path,
};

/// Only the owner lists the folder.
const FOLDER_MODE: u32 = 0o700;
/// Only the owner reads a file: all but one contain a private key.
const FILE_MODE: u32 = 0o600;

/// Writes all files, by name, or none if one exists. A missing folder is made.
///
/// # Errors
/// A file exists; it is named.
pub(super) fn write(folder: &Path, files: &[(String, String)]) -> Result<()> {
    let existing = files.iter().map(|(name, _)| folder.join(name));
    let existing: Vec<_> = existing
        .filter(|path| path.symlink_metadata().is_ok())
        .map(|path| path.display().to_string())
        .collect();
    if !existing.is_empty() {
        bail!(
            "existing files are not overwritten: {}; name another folder, with --authority {} if its \
             certificates should stay valid",
            existing.join(", "),
            folder.display()
        );
    }
    let mut builder = DirBuilder::new();
    let made = builder.recursive(true).mode(FOLDER_MODE).create(folder);
    made.with_context(|| format!("make {}", folder.display()))?;
    for (name, text) in files {
        let path = folder.join(name);
        create(&path, text).with_context(|| format!("write {}", path.display()))?;
    }
    Ok(())
}

fn create(path: &Path, text: &str) -> std::io::Result<()> {
    let mut options = OpenOptions::new();
    let mut file = options
        .write(true)
        .create_new(true)
        .mode(FILE_MODE)
        .open(path)?;
    file.write_all(text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    fn files(names: &[&str]) -> Vec<(String, String)> {
        let file = |name: &&str| ((*name).to_owned(), format!("text of {name}"));
        names.iter().map(file).collect()
    }

    fn mode(path: &Path) -> u32 {
        path.metadata().unwrap().permissions().mode() & 0o777
    }

    #[test]
    fn only_the_owner_reads_keys() {
        let parent = tempfile::tempdir().unwrap();
        let path = parent.path().join("keys");
        write(&path, &files(&["a", "b"])).unwrap();
        assert_eq!(mode(&path), FOLDER_MODE);
        assert_eq!(mode(&path.join("a")), FILE_MODE);
        assert_eq!(
            std::fs::read_to_string(path.join("b")).unwrap(),
            "text of b"
        );
    }

    #[test]
    fn existing_files_are_named_and_nothing_is_written() {
        let parent = tempfile::tempdir().unwrap();
        std::fs::write(parent.path().join("b"), "mine").unwrap();
        // a dangling link is a file too: writing would follow it
        std::os::unix::fs::symlink("/nonexistent", parent.path().join("c")).unwrap();
        let error = write(parent.path(), &files(&["a", "b", "c"])).unwrap_err();
        let error = error.to_string();
        assert!(error.contains("/b, ") && error.contains("/c;"), "{error}");
        assert!(!parent.path().join("a").exists());
        assert_eq!(
            std::fs::read_to_string(parent.path().join("b")).unwrap(),
            "mine"
        );
    }
}
