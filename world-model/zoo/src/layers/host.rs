//! The values of CPU tensors as plain slices, for kernels.

use candle_core::{CpuStorage, Layout, Result};

/// The f32 values of an operand, which must be contiguous.
///
/// # Errors
/// If the layout has gaps or the values are not f32.
pub(crate) fn slice<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    let values = storage.as_slice::<f32>()?;
    let within = layout
        .contiguous_offsets()
        .and_then(|(start, end)| values.get(start..end));
    match within {
        Some(values) => Ok(values),
        None => candle_core::bail!("operand of shape {:?} is not contiguous", layout.shape()),
    }
}
