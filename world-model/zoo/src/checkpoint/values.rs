//! Reading a tensor's values from the file.

use candle_core::{DType, Device, Tensor};
use half::{bf16, f16};
use rayon::prelude::*;

use super::Element;
use super::bytes::Bytes;
use super::entry::Entry;
use crate::{Error, Result};

/// Bytes that a task reads before their pages are given back: a whole embedding table can be a gigabyte.
const CHUNK: usize = 2 << 20;

/// Values that a task compares.
const COMPARED: usize = 64 << 10;

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

/// What `read` makes of the values of `entry`, rows in order: straight from the file if they are f32 there, one after the
/// other, and in the byte order of this machine.
pub(super) fn with_f32<R>(bytes: &Bytes, entry: &Entry, read: impl FnOnce(&[f32]) -> R) -> R {
    let is_plain = entry.element == Element::F32 && entry.strides.is_none();
    if is_plain
        && cfg!(target_endian = "little")
        && let Ok(values) = bytemuck::try_cast_slice(stored(bytes, entry))
    {
        let made = read(values);
        bytes.release(entry.start, size_of_val(values));
        return made;
    }
    read(&collect(bytes, entry, |value| value))
}

/// Whether all values are finite, and stay so in bf16 if they are `rounded` to it.
pub(super) fn stay_finite(values: &[f32], rounded: bool) -> bool {
    // The first value that is too large: infinity, or half way between it and the largest bf16, from where on rounding
    // gives infinity.
    let bound: u32 = if rounded { 0x7f7f_8000 } else { 0x7f80_0000 };
    values.par_chunks(COMPARED).all(|values| {
        // Without an early exit, so that the loop is vectorised.
        values
            .iter()
            .fold(true, |all, v| all & (v.abs().to_bits() < bound))
    })
}

/// Bytes from the first value of `entry` to the end of the last one.
pub(super) fn stored<'a>(bytes: &'a Bytes, entry: &Entry) -> &'a [u8] {
    let span = entry.span();
    let all = span.and_then(|span| bytes.as_slice().get(entry.start..entry.start + span));
    // Opening the file checked it.
    debug_assert!(all.is_some(), "an entry lies beyond its file");
    all.unwrap_or_default()
}

fn collect<T>(bytes: &Bytes, entry: &Entry, from: impl Fn(f32) -> T + Sync) -> Vec<T>
where
    T: Copy + Default + Send,
{
    let all = stored(bytes, entry);
    let size = entry.element.size();
    match &entry.strides {
        None => {
            let mut values = vec![T::default(); entry.count()];
            let parts = values.par_chunks_mut(CHUNK / size);
            parts
                .zip(all.par_chunks(CHUNK))
                .enumerate()
                .for_each(|(i, (values, chunk))| {
                    convert(values, chunk, entry.element, &from);
                    bytes.release(entry.start + i * CHUNK, chunk.len());
                });
            values
        }
        Some(strides) => {
            let mut values = vec![T::default(); entry.count()];
            for (value, at) in values.iter_mut().zip(offsets(&entry.shape, strides)) {
                let stored = all.get(at * size..(at + 1) * size);
                // The span ends with the value of the greatest offset.
                debug_assert!(stored.is_some(), "an offset lies beyond the span");
                let stored = stored.unwrap_or_default();
                convert(std::slice::from_mut(value), stored, entry.element, &from);
            }
            bytes.release(entry.start, all.len());
            values
        }
    }
}

/// Writes the values in `bytes`, whole ones, to `values`.
fn convert<T>(values: &mut [T], bytes: &[u8], element: Element, from: &impl Fn(f32) -> T) {
    fn each<T, const N: usize>(values: &mut [T], bytes: &[u8], value: impl Fn([u8; N]) -> T) {
        for (to, bytes) in values.iter_mut().zip(bytes.as_chunks().0) {
            *to = value(*bytes);
        }
    }
    match element {
        // To f32 first: nothing here computes with more.
        Element::F64 => each(values, bytes, |b| from(f64::from_le_bytes(b) as f32)),
        Element::F32 => each(values, bytes, |b| from(f32::from_le_bytes(b))),
        Element::F16 => each(values, bytes, |b| from(f16::from_le_bytes(b).to_f32())),
        Element::BF16 => each(values, bytes, |b| from(bf16::from_le_bytes(b).to_f32())),
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
    fn what_bf16_cannot_hold_is_told() {
        let largest = bf16::MAX.to_f32();
        let half_way = f32::from_bits(0x7f7f_8000);
        let cases = [
            (0.0, true, true),
            (-largest, true, true),
            (f32::from_bits(0x7f7f_7fff), true, true),
            (half_way, true, false),
            (f32::MIN, true, false),
            (f32::INFINITY, false, false),
            (f32::NEG_INFINITY, false, false),
            (f32::NAN, false, false),
            (-f32::NAN, false, false),
        ];
        for (value, in_f32, in_bf16) in cases {
            let values = [1.0, value, -1.0];
            assert_eq!(stay_finite(&values, false), in_f32, "{value}");
            assert_eq!(stay_finite(&values, true), in_bf16, "{value}");
            assert_eq!(bf16::from_f32(value).is_finite(), in_bf16, "{value}");
        }
        assert!(stay_finite(&[], true));
    }

    #[test]
    fn a_transposed_matrix_is_read_row_by_row() {
        let order: Vec<usize> = offsets(&[3, 2], &[1, 3]).collect();
        assert_eq!(order, [0, 3, 1, 4, 2, 5]);
    }
}
