//! Results on standard output.

use anyhow::{Context as _, Result};
use std::fmt::Display;
use std::io::{ErrorKind, Write as _};

/// Prints a result. A closed pipe (`wm … | head`) is not an error.
pub(crate) fn print(text: impl Display) -> Result<()> {
    let mut output = std::io::stdout().lock();
    match write!(output, "{text}").and_then(|()| output.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        result => result.context("writing to standard output"),
    }
}
