//! Reading a tensor's values from the file.

use candle_core::{DType, Device, Tensor};
use half::{bf16, f16};

use super::Element;
use super::bytes::Bytes;
use super::entry::Entry;
use crate::{Error, Result};

/// Bytes that are read before their pages are given back: a whole embedding table can be a gigabyte.
const CHUNK: usize = 16 << 20;

/// Values in the format that was requested.
pub(super) enum Values {
    F32(Vec<f32>),
    F16(Vec<f16>),
    Bf16(Vec<bf16>),
}

/// The values of `entry`, rows in order.
pub(super) fn read(bytes: &Bytes, entry: &Entry, dtype: DType) -> Result<Values> {
    Ok(match dtype {
        DType::F32 => Values::F32(collect(bytes, entry, |value| value)),
        DType::F16 => Values::F16(collect(bytes, entry, f16::from_f32)),
        DType::BF16 => Values::Bf16(collect(bytes, entry, bf16::from_f32)),
        other => {
            let reason = format!("{other:?}, expected F32, F16 or BF16");
            return Err(Error::Model(wm_model::Error::config("dtype", reason)));
        }
    })
}

/// Whether no value is NaN or infinite.
pub(super) fn are_finite(values: &Values) -> bool {
    // Without an early exit, so that the loop is vectorised.
    match values {
        Values::F32(values) => values.iter().fold(true, |all, v| all & v.is_finite()),
        Values::F16(values) => values.iter().fold(true, |all, v| all & v.is_finite()),
        Values::Bf16(values) => values.iter().fold(true, |all, v| all & v.is_finite()),
    }
}

/// The values as a tensor of `shape`.
pub(super) fn into_tensor(values: Values, shape: &[usize], device: &Device) -> Result<Tensor> {
    Ok(match values {
        Values::F32(values) => Tensor::from_vec(values, shape, device)?,
        Values::F16(values) => Tensor::from_vec(values, shape, device)?,
        Values::Bf16(values) => Tensor::from_vec(values, shape, device)?,
    })
}

fn collect<T>(bytes: &Bytes, entry: &Entry, from: impl Fn(f32) -> T) -> Vec<T> {
    let mut values = Vec::with_capacity(entry.count());
    // Checked when the file was opened: the entry lies within the file.
    let span = entry.span().unwrap_or_default();
    let all = bytes.as_slice().get(entry.start..entry.start + span);
    let all = all.unwrap_or_default();
    match &entry.strides {
        None => {
            for (i, chunk) in all.chunks(CHUNK).enumerate() {
                extend(&mut values, chunk, entry.element, &from);
                bytes.release(entry.start + i * CHUNK, chunk.len());
            }
        }
        Some(strides) => {
            let size = entry.element.size();
            for at in offsets(&entry.shape, strides) {
                let value = all.get(at * size..(at + 1) * size).unwrap_or_default();
                extend(&mut values, value, entry.element, &from);
            }
            bytes.release(entry.start, span);
        }
    }
    values
}

/// Adds the values in `bytes`, whole ones, to `values`.
fn extend<T>(values: &mut Vec<T>, bytes: &[u8], element: Element, from: &impl Fn(f32) -> T) {
    match element {
        Element::F64 => values.extend(
            // To f32 first: nothing here computes with more.
            bytes
                .as_chunks()
                .0
                .iter()
                .map(|b| from(f64::from_le_bytes(*b) as f32)),
        ),
        Element::F32 => {
            values.extend(
                bytes
                    .as_chunks()
                    .0
                    .iter()
                    .map(|b| from(f32::from_le_bytes(*b))),
            );
        }
        Element::F16 => values.extend(
            bytes
                .as_chunks()
                .0
                .iter()
                .map(|b| from(f16::from_le_bytes(*b).to_f32())),
        ),
        Element::BF16 => values.extend(
            bytes
                .as_chunks()
                .0
                .iter()
                .map(|b| from(bf16::from_le_bytes(*b).to_f32())),
        ),
        // Not asked for: [`super::Checkpoint::tensor`] refuses them.
        Element::I64 | Element::I32 | Element::I16 | Element::I8 | Element::U8 | Element::Bool => {}
    }
}

/// Where each value lies, in values from the first, rows in order.
pub(super) fn offsets(shape: &[usize], strides: &[usize]) -> impl Iterator<Item = usize> {
    let count: usize = shape.iter().product();
    let axes: Vec<(usize, usize)> = shape.iter().copied().zip(strides.iter().copied()).collect();
    (0..count).map(move |mut i| {
        let mut at = 0;
        for (size, stride) in axes.iter().rev() {
            at += i % size * stride;
            i /= size;
        }
        at
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transposed_matrix_is_read_row_by_row() {
        let order: Vec<usize> = offsets(&[3, 2], &[1, 3]).collect();
        assert_eq!(order, [0, 3, 1, 4, 2, 5]);
    }
}
