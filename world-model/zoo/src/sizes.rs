//! Checks of configuration values, before a network is built from them.

use crate::Result;

/// Sizes above this are refused, so that products of sizes cannot overflow.
const LARGEST: usize = 1 << 20;

/// More layers than this are refused, so that a slip of the pen does not become a list of millions of missing tensors.
const MOST_LAYERS: usize = 1 << 12;

/// Checks that every size can be built.
///
/// # Errors
/// With the first field that is zero or absurdly large.
pub(crate) fn check_sizes(fields: &[(&'static str, usize)]) -> Result<()> {
    for (field, value) in fields {
        if *value == 0 || *value > LARGEST {
            let reason = format!("{value}, expected 1 to {LARGEST}");
            return Err(wm_model::Error::config(field, reason).into());
        }
    }
    Ok(())
}

/// Checks that every number of layers is one that a network could have.
///
/// # Errors
/// With the first field that is zero or absurdly large.
pub(crate) fn check_counts(fields: &[(&'static str, usize)]) -> Result<()> {
    for (field, value) in fields {
        if *value == 0 || *value > MOST_LAYERS {
            let reason = format!("{value}, expected 1 to {MOST_LAYERS}");
            return Err(wm_model::Error::config(field, reason).into());
        }
    }
    Ok(())
}

/// Checks that `value` is a multiple of `of`.
///
/// # Errors
/// With both values.
pub(crate) fn check_multiple(
    (field, value): (&'static str, usize),
    (of_field, of): (&'static str, usize),
) -> Result<()> {
    if of == 0 || !value.is_multiple_of(of) {
        let reason = format!("{value}, expected a multiple of {of_field} = {of}");
        return Err(wm_model::Error::config(field, reason).into());
    }
    Ok(())
}

/// The error of an input `what` whose shape is not the `expected` one.
pub(crate) fn shape_error(
    what: &'static str,
    expected: impl Into<String>,
    found: &candle_core::Tensor,
) -> crate::Error {
    wm_model::Error::Shape {
        what,
        expected: expected.into(),
        found: found.dims().to_vec(),
    }
    .into()
}
