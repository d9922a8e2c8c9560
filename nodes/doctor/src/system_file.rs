//! Text files of `/proc` and `/sys`.

use crate::DoctorError;
use std::path::Path;

/// Reads a file that every system has.
///
/// # Errors
/// The file cannot be read.
pub(crate) fn read(file: &str) -> Result<String, DoctorError> {
    std::fs::read_to_string(file).map_err(|source| DoctorError::System {
        file: Path::new(file).to_owned(),
        source,
    })
}

/// Reads a file that some systems lack; without the white space at its end.
pub(crate) fn read_if_there(file: impl AsRef<Path>) -> Option<String> {
    let text = std::fs::read_to_string(file).ok()?;
    Some(text.trim_end().to_owned())
}
