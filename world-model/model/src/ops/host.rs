//! The values of CPU tensors as plain slices, for kernels.

use std::ops::Deref;

use candle_core::{CpuStorage, Layout, Result, Storage, Tensor};

/// The f32 values of an operand, which must be contiguous.
///
/// # Errors
/// If the layout has gaps or the values are not f32.
pub(crate) fn slice<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    let values = storage.as_slice::<f32>()?;
    match layout.contiguous_offsets() {
        Some((start, end)) => values
            .get(start..end)
            .ok_or_else(|| candle_core::Error::Msg("layout exceeds its storage".into())),
        None => candle_core::bail!("operand of shape {:?} is not contiguous", layout.shape()),
    }
}

/// Read access to the values of a contiguous f32 tensor on the CPU.
pub(crate) struct Host<'a, Guard> {
    storage: Guard,
    layout: &'a Layout,
}

/// Locks `tensor` for reading.
pub(crate) fn host(tensor: &Tensor) -> Host<'_, impl Deref<Target = Storage> + '_> {
    let (storage, layout) = tensor.storage_and_layout();
    Host { storage, layout }
}

impl<Guard: Deref<Target = Storage>> Host<'_, Guard> {
    /// The values in row-major order.
    ///
    /// # Errors
    /// If the tensor is not on the CPU, not f32 or not contiguous.
    pub(crate) fn values(&self) -> Result<&[f32]> {
        match &*self.storage {
            Storage::Cpu(storage) => slice(storage, self.layout),
            _ => candle_core::bail!("expected a tensor on the CPU"),
        }
    }
}
