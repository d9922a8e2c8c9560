//! A configuration next to the weights. An existing one belongs to the user.

use anyhow::{Context as _, Result};
use serde_json::Value;
use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write as _};
use std::path::Path;

/// The result of writing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WriteOutcome {
    /// The file has the content now.
    Yes,
    /// A different file was kept.
    Kept,
}

/// Writes `content` to `path`; replaces an existing different file only if `overwrite`.
pub(super) fn write(path: &Path, content: &str, overwrite: bool) -> Result<WriteOutcome> {
    let context = || path.display().to_string();
    match OpenOptions::new().write(true).create_new(true).open(path) {
        Ok(mut file) => file.write_all(content.as_bytes()).with_context(context)?,
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            // another order or other spaces are not an edit
            let value = |text: &[u8]| serde_json::from_slice::<Value>(text).ok();
            let found = fs::read(path).with_context(context)?;
            let is_same = value(&found).is_some_and(|v| Some(v) == value(content.as_bytes()));
            match (is_same, overwrite) {
                (true, _) => {}
                (false, true) => fs::write(path, content).with_context(context)?,
                (false, false) => return Ok(WriteOutcome::Kept),
            }
        }
        Err(error) => return Err(error).with_context(context),
    }
    Ok(WriteOutcome::Yes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edited_configuration_is_kept_without_overwrite() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.json");
        let content = || fs::read_to_string(&path).unwrap();
        let preset = r#"{"depth": 24, "heads": 16}"#;
        assert_eq!(write(&path, preset, false).unwrap(), WriteOutcome::Yes);
        assert_eq!(write(&path, preset, false).unwrap(), WriteOutcome::Yes);
        let reordered = r#"{"heads":16,"depth":24}"#;
        assert_eq!(write(&path, reordered, false).unwrap(), WriteOutcome::Yes);
        assert_eq!(content(), preset);
        for edited in [r#"{"depth": 12, "heads": 16}"#, "not JSON"] {
            fs::write(&path, edited).unwrap();
            assert_eq!(write(&path, preset, false).unwrap(), WriteOutcome::Kept);
            assert_eq!(content(), edited);
        }
        assert_eq!(write(&path, preset, true).unwrap(), WriteOutcome::Yes);
        assert_eq!(content(), preset);
    }
}
