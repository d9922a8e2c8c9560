//! A configuration beside the weights. Once it exists, it belongs to the user.

use anyhow::{Context as _, Result};
use serde_json::Value;
use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write as _};
use std::path::Path;

/// What became of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Written {
    /// It has the content now.
    Yes,
    /// Another one was there and was kept.
    Kept,
}

/// Writes `content` to `path`; an existing file that differs is replaced only if `overwrite` says so.
pub(super) fn write(path: &Path, content: &str, overwrite: bool) -> Result<Written> {
    let context = || path.display().to_string();
    match OpenOptions::new().write(true).create_new(true).open(path) {
        Ok(mut file) => file.write_all(content.as_bytes()).with_context(context)?,
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            // Order and spaces of JSON are no edit.
            let value = |text: &[u8]| serde_json::from_slice::<Value>(text).ok();
            let found = fs::read(path).with_context(context)?;
            let is_same = value(&found).is_some_and(|v| Some(v) == value(content.as_bytes()));
            match (is_same, overwrite) {
                (true, _) => {}
                (false, true) => fs::write(path, content).with_context(context)?,
                (false, false) => return Ok(Written::Kept),
            }
        }
        Err(error) => return Err(error).with_context(context),
    }
    Ok(Written::Yes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edited_configuration_is_kept_unless_told_otherwise() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.json");
        let content = || fs::read_to_string(&path).unwrap();
        let preset = r#"{"depth": 24, "heads": 16}"#;
        assert_eq!(write(&path, preset, false).unwrap(), Written::Yes);
        assert_eq!(write(&path, preset, false).unwrap(), Written::Yes);
        let reordered = r#"{"heads":16,"depth":24}"#;
        assert_eq!(write(&path, reordered, false).unwrap(), Written::Yes);
        assert_eq!(content(), preset);
        for edited in [r#"{"depth": 12, "heads": 16}"#, "not JSON"] {
            fs::write(&path, edited).unwrap();
            assert_eq!(write(&path, preset, false).unwrap(), Written::Kept);
            assert_eq!(content(), edited);
        }
        assert_eq!(write(&path, preset, true).unwrap(), Written::Yes);
        assert_eq!(content(), preset);
    }
}
