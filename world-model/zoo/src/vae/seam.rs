//! Where tensors of the caller become activations and back: checks, number ranges, number formats.

use candle_core::{DType, Tensor};

use crate::sizes::check_sizes;
use crate::{Error, Result};

/// Checks that `x` is a batch of grids (N, h, w, `channels`) whose sides are multiples of `step`.
///
/// # Errors
/// [`wm_model::Error::Shape`] that names `what`.
pub(super) fn check_grid(
    what: &'static str,
    x: &Tensor,
    channels: usize,
    step: usize,
) -> Result<()> {
    if let &[images, height, width, found] = x.dims() {
        let fits = |side: usize| side > 0 && side.is_multiple_of(step);
        if images > 0 && fits(height) && fits(width) && found == channels {
            return Ok(());
        }
    }
    let expected = if step == 1 {
        format!("(N, h, w, {channels})")
    } else {
        format!("(N, H, W, {channels}) with H and W multiples of {step}")
    };
    Err(wm_model::Error::Shape {
        what,
        expected,
        found: x.dims().to_vec(),
    }
    .into())
}

/// Checks that there are `widths`, none of them 0, and that groups (no more than channels) and heads divide
/// each.
///
/// # Errors
/// [`wm_model::Error::Config`] that names `field`.
pub(super) fn check_widths(
    field: &'static str,
    widths: &[usize],
    groups: usize,
    heads: usize,
) -> Result<()> {
    if widths.is_empty() {
        return Err(config_error(field, "no level, expected at least one"));
    }
    check_sizes(&[("groups", groups), ("heads", heads)])?;
    for width in widths {
        check_sizes(&[(field, *width)])?;
        for (divisor, name) in [(groups.min(*width), "groups"), (heads, "heads")] {
            if !width.is_multiple_of(divisor) {
                return Err(config_error(
                    field,
                    format!("{width} channels are not a multiple of {divisor} {name}"),
                ));
            }
        }
    }
    Ok(())
}

/// Channels at each level from their multipliers, in the same order.
pub(super) fn widths(base: usize, multipliers: &[usize]) -> Vec<usize> {
    // A product that does not fit is refused by whatever check or tensor comes next, never wrapped.
    let width = |multiplier: &usize| multiplier.saturating_mul(base);
    multipliers.iter().map(width).collect()
}

/// An error about `field` of a configuration.
pub(super) fn config_error(field: &'static str, reason: impl Into<String>) -> Error {
    wm_model::Error::config(field, reason).into()
}

/// Pixels of 0..1 to -1..1, f32.
pub(super) fn to_signed(image: &Tensor) -> Result<Tensor> {
    Ok(image.to_dtype(DType::F32)?.affine(2.0, -1.0)?)
}

/// Pixels of -1..1 to 0..1, f32; what a network puts outside is cut off.
pub(super) fn to_unit(image: &Tensor) -> Result<Tensor> {
    let image = image.to_dtype(DType::F32)?.affine(0.5, 0.5)?;
    Ok(image.clamp(0f32, 1f32)?)
}
