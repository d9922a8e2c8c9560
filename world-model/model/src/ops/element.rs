//! Number formats that packed weights are kept in.

use std::cell::RefCell;

use bytemuck::Pod;
use half::bf16;

use super::simd::{Bf16Unit, InstructionSet, Int8Unit, LANES, Lanes};
use super::vectorised::vectorised;

/// The largest absolute value of a weight, and of an input, of 8 bits. -128 does not occur: it has no opposite.
pub(crate) const INT8_MOST: f32 = 127.0;

use crate::NumberFormat;

impl NumberFormat {
    /// What multiplies bf16, if the format allows inputs to be rounded to it and the processor has it.
    pub(crate) fn bf16_unit(self) -> Option<Bf16Unit> {
        match self {
            Self::F32 => None,
            Self::Bf16 | Self::Int8 => Bf16Unit::detect(),
        }
    }

    /// What this machine computes with weights of the format: its instruction set, and instructions of their own for bf16 and
    /// bytes where the format is for them: `avx2`, `avx512, amx-bf16`, .. With others, sums of f32 are rounded otherwise.
    pub fn kernels(self) -> String {
        let mut names = vec![InstructionSet::detect().name()];
        names.extend(self.bf16_unit().map(Bf16Unit::name));
        if self == Self::Int8 {
            names.push(Int8Unit::detect().name());
        }
        names.join(", ")
    }
}

/// A packed weight, or an input that is multiplied with it.
pub(crate) trait Element: Pod + Send + Sync + std::fmt::Debug {
    const ZERO: Self;

    /// Neighbouring inputs of one output that lie side by side in a panel, because one instruction multiplies them all.
    const GROUP: usize;

    /// Vectors of outputs in a panel at most, on this machine.
    fn tile_vectors() -> usize {
        InstructionSet::detect().tile_vectors()
    }

    fn from_f32(value: f32) -> Self;

    /// Rounds `values` to the front of `out`, which is at least as long.
    fn round(values: &[f32], out: &mut [Self]);

    /// Rounds `lanes` to [`LANES`] values at `out`.
    ///
    /// # Safety
    /// As many must be writable, and the instruction set of `lanes` enabled.
    #[inline(always)]
    unsafe fn store<L: Lanes>(lanes: L, out: *mut Self) {
        let mut values = [0.0; LANES];
        // SAFETY: there is room for all lanes in `values`, and as for this function.
        unsafe {
            lanes.store(values.as_mut_ptr());
            out.cast::<[Self; LANES]>()
                .write_unaligned(values.map(Self::from_f32));
        }
    }
}

impl Element for f32 {
    const ZERO: Self = 0.0;
    const GROUP: usize = 1;

    #[inline(always)]
    fn from_f32(value: f32) -> Self {
        value
    }

    fn round(values: &[f32], out: &mut [f32]) {
        if let Some(out) = out.get_mut(..values.len()) {
            out.copy_from_slice(values);
        }
    }
}

impl Element for bf16 {
    const ZERO: Self = bf16::ZERO;
    const GROUP: usize = 2;

    /// To the nearest, and to even between two. Without a branch, so that the compiler vectorises it.
    #[inline(always)]
    fn from_f32(value: f32) -> Self {
        let bits = value.to_bits();
        let rounded = bits.wrapping_add(0x7fff + ((bits >> 16) & 1));
        // What is no number must not become infinite.
        let bits = if value.is_nan() {
            bits | 0x40_0000
        } else {
            rounded
        };
        bf16::from_bits((bits >> 16) as u16)
    }

    fn round(values: &[f32], out: &mut [bf16]) {
        round_to_bf16(values, out);
    }
}

impl Element for i8 {
    const ZERO: Self = 0;
    const GROUP: usize = 4;

    fn tile_vectors() -> usize {
        Int8Unit::detect().tile_vectors()
    }

    /// To the nearest, and to even between two; the nearest that there is of what is out of range.
    #[inline(always)]
    fn from_f32(value: f32) -> Self {
        value.round_ties_even().clamp(-INT8_MOST, INT8_MOST) as i8
    }

    fn round(values: &[f32], out: &mut [i8]) {
        for (value, out) in values.iter().zip(out) {
            *out = Self::from_f32(*value);
        }
    }
}

/// A float format of inputs, weights, keys and values.
pub(crate) trait Float: Element {
    fn to_f32(self) -> f32;

    /// Calls `use_it` with `values`: as they are, or rounded in a buffer of the thread.
    fn with_rounded<R>(values: &[f32], use_it: impl FnOnce(&[Self]) -> R) -> R;

    /// Rounds a group of rows of one length ([`Element::GROUP`] rows) to `out`, interleaved: for each column the values of all
    /// rows.
    ///
    /// # Panics
    /// If there are more or fewer rows.
    fn interleave(rows: &[&[f32]], out: &mut [Self]);
}

impl Float for f32 {
    #[inline(always)]
    fn to_f32(self) -> f32 {
        self
    }

    fn with_rounded<R>(values: &[f32], use_it: impl FnOnce(&[Self]) -> R) -> R {
        use_it(values)
    }

    fn interleave(rows: &[&[f32]], out: &mut [f32]) {
        assert_eq!(rows.len(), Self::GROUP, "rows of a group");
        for row in rows {
            <Self as Element>::round(row, out);
        }
    }
}

impl Float for bf16 {
    /// By a shift, which the compiler vectorises.
    #[inline(always)]
    fn to_f32(self) -> f32 {
        f32::from_bits(u32::from(self.to_bits()) << 16)
    }

    fn with_rounded<R>(values: &[f32], use_it: impl FnOnce(&[Self]) -> R) -> R {
        thread_local! {
            static ROUNDED: RefCell<Vec<bf16>> = const { RefCell::new(Vec::new()) };
        }
        ROUNDED.with_borrow_mut(|rounded| {
            rounded.resize(values.len(), bf16::ZERO);
            Self::round(values, rounded);
            use_it(rounded)
        })
    }

    fn interleave(rows: &[&[f32]], out: &mut [bf16]) {
        assert_eq!(rows.len(), Self::GROUP, "rows of a group");
        for pair in rows.as_chunks::<2>().0 {
            interleave_bf16(*pair, out);
        }
    }
}

/// Bytes that were widened, because the processor multiplies 16 bits.
impl Element for i16 {
    const ZERO: Self = 0;
    const GROUP: usize = 2;

    fn from_f32(value: f32) -> Self {
        i8::from_f32(value).into()
    }

    fn round(values: &[f32], out: &mut [i16]) {
        for (value, out) in values.iter().zip(out) {
            *out = Self::from_f32(*value);
        }
    }
}

vectorised! {
    /// Rounds `values` times `factor` to `out`.
    pub(crate) fn round_scaled<T: Element>(values: &[f32], factor: f32, out: &mut [T]) {
        for (value, out) in values.iter().zip(out) {
            *out = T::from_f32(value * factor);
        }
    }
}

vectorised! {
    fn interleave_bf16(rows: [&[f32]; 2], out: &mut [bf16]) {
        let [first, second] = rows;
        // As numbers of 32 bits, which the compiler vectorises.
        let pairs = bytemuck::cast_slice_mut::<bf16, u8>(out).as_chunks_mut::<4>().0;
        for ((pair, first), second) in pairs.iter_mut().zip(first).zip(second) {
            let bits = |value| u32::from(<bf16 as Element>::from_f32(value).to_bits());
            *pair = (bits(*first) | bits(*second) << 16).to_le_bytes();
        }
    }
}

vectorised! {
    fn round_to_bf16(values: &[f32], out: &mut [bf16]) {
        for (value, out) in values.iter().zip(out) {
            *out = <bf16 as Element>::from_f32(*value);
        }
    }
}

vectorised! {
    /// Writes the rows of a panel (pairs of neighbouring rows, `width` columns) of bf16 as rows of f32.
    pub(crate) fn widen(pairs: &[bf16], width: usize, rows: &mut [f32]) {
        for (pairs, rows) in pairs.chunks_exact(2 * width).zip(rows.chunks_exact_mut(2 * width)) {
            let (first, second) = rows.split_at_mut(width);
            for ((pair, first), second) in pairs.as_chunks::<2>().0.iter().zip(first).zip(second) {
                *first = Float::to_f32(pair[0]);
                *second = Float::to_f32(pair[1]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_are_named() {
        let of_f32 = NumberFormat::F32.kernels();
        assert_eq!(of_f32, InstructionSet::detect().name());
        for format in [NumberFormat::Bf16, NumberFormat::Int8] {
            let names = format.kernels();
            assert!(names.starts_with(&of_f32), "{names}");
            let bf16 = Bf16Unit::detect().is_none_or(|unit| names.contains(unit.name()));
            let int8 = names.ends_with(Int8Unit::detect().name());
            assert!(bf16 && int8 == (format == NumberFormat::Int8), "{names}");
        }
    }

    #[test]
    fn numbers_are_rounded_as_the_library_rounds_them() {
        let special = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, -0.0, 1e-40];
        let spread = (0..100_000u32).map(|i| f32::from_bits(i.wrapping_mul(2_654_435_761)));
        for value in spread.chain(special) {
            let (found, expected) = (<bf16 as Element>::from_f32(value), bf16::from_f32(value));
            assert_eq!(found.to_bits(), expected.to_bits(), "{value}");
        }
    }
}
