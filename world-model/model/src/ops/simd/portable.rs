//! Lanes that the compiler maps to what the processor has.

use super::{DotInt8, LANES, Lanes};

/// What any processor has.
#[derive(Clone, Copy)]
pub(crate) struct Portable([f32; LANES]);

impl Lanes for Portable {
    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self([v; LANES])
    }

    #[inline(always)]
    fn splat_bits(bits: u32) -> Self {
        Self([f32::from_bits(bits); LANES])
    }

    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        // SAFETY: the caller vouches for sixteen f32; the read needs no alignment.
        Self(unsafe { p.cast::<[f32; LANES]>().read_unaligned() })
    }

    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        // SAFETY: the caller vouches for sixteen f32; the write needs no alignment.
        unsafe { p.cast::<[f32; LANES]>().write_unaligned(self.0) };
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        // Not `f32::mul_add`: without the instruction that is a slow library call.
        let mut out = c.0;
        for ((out, a), b) in out.iter_mut().zip(self.0).zip(b.0) {
            *out += a * b;
        }
        Self(out)
    }

    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane] + b.0[lane]))
    }

    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane] - b.0[lane]))
    }

    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self(std::array::from_fn(|lane| self.0[lane] * b.0[lane]))
    }

    #[inline(always)]
    fn i32_to_f32(self) -> Self {
        Self(self.0.map(|bits| bits.to_bits().cast_signed() as f32))
    }
}

impl DotInt8 for Portable {
    #[inline(always)]
    fn dot_int8(self, b: Self, c: Self) -> Self {
        let mut out = c.0;
        for ((out, a), b) in out.iter_mut().zip(self.0).zip(b.0) {
            let products = a.to_bits().to_ne_bytes().into_iter();
            let products = products.zip(b.to_bits().to_ne_bytes());
            let sum = products
                .map(|(a, b)| i32::from(a) * i32::from(b.cast_signed()))
                .sum::<i32>();
            // Wraps, as the instructions do: with the offset of the inputs a sum may be out of range before it is whole.
            let sum = out.to_bits().cast_signed().wrapping_add(sum);
            *out = f32::from_bits(sum.cast_unsigned());
        }
        Self(out)
    }
}
