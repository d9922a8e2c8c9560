//! Tensors as plain slices, for the kernels.

use candle_core::{DType, Storage, Tensor};

use rayon::prelude::*;
use wm_model::ops::HeadRows;

use crate::Result;

/// Values that one task copies at least.
const COPIED: usize = 64 * 1024;

/// Whether [`with_values`] can replace operations of candle: `x` has values of f32 on the CPU, and no gradients go through it.
pub(crate) fn is_plain(x: &Tensor) -> bool {
    x.dtype() == DType::F32 && x.device().is_cpu() && !x.track_op()
}

/// What `read` makes of the values of `x`, a tensor of f32 on the CPU.
pub(crate) fn with_values<R>(x: &Tensor, read: impl FnOnce(&[f32]) -> R) -> Result<R> {
    let x = x.contiguous()?;
    let (storage, layout) = x.storage_and_layout();
    let values = match &*storage {
        Storage::Cpu(storage) => storage.as_slice::<f32>()?,
        _ => return Err(not_here(&x)),
    };
    match layout
        .contiguous_offsets()
        .and_then(|(start, end)| values.get(start..end))
    {
        Some(values) => Ok(read(values)),
        None => Err(not_here(&x)),
    }
}

/// What `read` makes of the values of `x` (B, heads, rows, dim), a tensor of f32 on the CPU whose last dimension lies
/// together, from the first on, and of how many values lie from one entry, head and row to the next.
pub(crate) fn with_heads<R>(x: &Tensor, read: impl FnOnce(HeadRows<'_>) -> R) -> Result<R> {
    let x = match x.stride() {
        [_, _, _, 1] => x.clone(),
        _ => x.contiguous()?,
    };
    let (storage, layout) = x.storage_and_layout();
    let values = match &*storage {
        Storage::Cpu(storage) => storage.as_slice::<f32>()?,
        _ => return Err(not_here(&x)),
    };
    match (layout.stride(), values.get(layout.start_offset()..)) {
        (&[entry, head, row, 1], Some(values)) => Ok(read(HeadRows {
            values,
            steps: [entry, head, row],
        })),
        _ => Err(not_here(&x)),
    }
}

/// A tensor of the shape of `x`, with the values of `x` after `change`.
pub(crate) fn changed(x: &Tensor, change: impl FnOnce(&mut [f32])) -> Result<Tensor> {
    let mut values: Vec<f32> = with_values(x, |x| {
        // By all threads: a large activation takes as long to copy as to change.
        x.par_iter().copied().with_min_len(COPIED).collect()
    })?;
    change(&mut values);
    Ok(Tensor::from_vec(values, x.shape(), x.device())?)
}

/// Whether all values are one in memory: a skeleton's.
pub(crate) fn is_repeated(x: &Tensor) -> bool {
    x.elem_count() > 1 && x.stride().iter().all(|stride| *stride == 0)
}

fn not_here(x: &Tensor) -> crate::Error {
    let message = format!("a kernel for f32 on the CPU was given {x:?}");
    candle_core::Error::Msg(message).into()
}
