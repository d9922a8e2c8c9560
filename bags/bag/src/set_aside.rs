//! Renames an existing bag or file to free its path.

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::SystemTime,
};

use crate::BagError;

/// Names tried for one time; recordings of one second are far fewer.
const NAMES_LIMIT: u32 = 1000;

/// Renames the file or folder at `path`: adds the time of its last change in UTC (`bag_2026-11-22T16-50-00Z`), and `_2`
/// and so on if that name is taken. Returns the new path, or `None` if `path` is missing or an empty folder.
///
/// # Errors
/// It cannot be renamed.
pub fn set_aside(path: impl AsRef<Path>) -> Result<Option<PathBuf>, BagError> {
    let path = path.as_ref();
    let failed = |source| BagError::io(path, source);
    let found = match fs::symlink_metadata(path) {
        Ok(found) => found,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(failed(error)),
    };
    if found.is_dir() && fs::read_dir(path).map_err(failed)?.next().is_none() {
        return Ok(None);
    }
    let free = free_name(path, found.modified().map_err(failed)?)?;
    fs::rename(path, &free).map_err(failed)?;
    Ok(Some(free))
}

/// A free path in the folder of `path`: its name and `time`.
///
/// # Errors
/// `path` has no name, or a thousand such names are taken.
pub fn free_name(path: &Path, time: SystemTime) -> Result<PathBuf, BagError> {
    let name = path.file_name().ok_or_else(|| BagError::NotABag {
        path: path.to_owned(),
        reason: "expected a name".to_owned(),
    })?;
    // As in ISO 8601; a colon is not allowed in the names of every file system.
    let time = humantime::format_rfc3339_seconds(time).to_string();
    let stem = format!("{}_{}", name.to_string_lossy(), time.replace(':', "-"));
    let free = (1..=NAMES_LIMIT)
        .map(|number| match number {
            1 => path.with_file_name(&stem),
            _ => path.with_file_name(format!("{stem}_{number}")),
        })
        .find(|candidate| fs::symlink_metadata(candidate).is_err());
    free.ok_or_else(|| BagError::Exists(path.with_file_name(stem)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_bag_set_aside_gets_a_free_name() {
        let scratch = tempfile::tempdir().unwrap();
        let path = scratch.path().join("bag");
        assert_eq!(set_aside(&path).unwrap(), None);
        fs::create_dir(&path).unwrap();
        assert_eq!(set_aside(&path).unwrap(), None, "an empty folder");
        let mut kept = Vec::new();
        for text in ["first", "second", "third"] {
            fs::create_dir_all(&path).unwrap();
            fs::write(path.join("a.mcap"), text).unwrap();
            kept.push((set_aside(&path).unwrap().unwrap(), text));
            assert!(!path.exists());
        }
        for (path, text) in kept {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            assert!(name.starts_with("bag_2") && !name.contains(':'), "{name}");
            assert_eq!(fs::read_to_string(path.join("a.mcap")).unwrap(), text);
        }
    }
}
