//! Settings files.

use std::{fs::File, io::Read as _, path::Path};

use serde::de::DeserializeOwned;

use crate::judges::{Error, Result};

/// Largest accepted settings file.
const MAX_BYTES: u64 = 1 << 20;

/// Reads a settings file.
pub(crate) fn read(path: &Path) -> Result<String> {
    let failed = |source| Error::File {
        path: path.to_owned(),
        source,
    };
    let mut text = String::new();
    let file = File::open(path).map_err(failed)?;
    file.take(MAX_BYTES + 1)
        .read_to_string(&mut text)
        .map_err(failed)?;
    if text.len() as u64 > MAX_BYTES {
        return Err(Error::FileTooLarge {
            path: path.to_owned(),
            limit: MAX_BYTES,
        });
    }
    Ok(text)
}

/// Parses YAML; `what` names the expected content.
pub(crate) fn parse<T: DeserializeOwned>(what: &'static str, yaml: &str) -> Result<T> {
    serde_yaml_ng::from_str(yaml).map_err(|source| Error::Yaml { what, source })
}
