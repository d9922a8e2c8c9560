//! Lengths of slices.

use crate::{Error, Result};

/// Checks the length of a slice, which is named `what` in the error.
pub(super) fn check_length(what: &'static str, slice: &[f32], expected: usize) -> Result<()> {
    if slice.len() == expected {
        return Ok(());
    }
    Err(Error::Shape {
        what,
        expected: format!("[{expected}]"),
        found: vec![slice.len()],
    })
}
