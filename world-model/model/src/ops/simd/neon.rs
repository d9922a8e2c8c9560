//! Lanes in the registers of 64-bit Arm.

use std::arch::aarch64::{
    float32x4_t, vaddq_f32, vcvtq_f32_s32, vdupq_n_f32, vfmaq_f32, vgetq_lane_f32, vld1q_f32,
    vmulq_f32, vreinterpretq_s32_f32, vst1q_f32, vsubq_f32,
};
use std::arch::asm;

use super::{DotBf16, DotInt8, LANES, Lanes};

/// Lanes of a register.
const WIDTH: usize = 4;
const REGISTERS: usize = LANES / WIDTH;

/// Four 128-bit registers.
#[derive(Clone, Copy)]
pub(crate) struct Neon([float32x4_t; REGISTERS]);

impl Lanes for Neon {
    #[inline(always)]
    fn splat(v: f32) -> Self {
        // SAFETY: the trait is used only where the instruction set is enabled.
        Self([unsafe { vdupq_n_f32(v) }; REGISTERS])
    }

    #[inline(always)]
    fn splat_bits(bits: u32) -> Self {
        Self::splat(f32::from_bits(bits))
    }

    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        // SAFETY: as above, and the caller vouches for `p`.
        let register = |i| unsafe { vld1q_f32(p.add(i * WIDTH)) };
        Self(std::array::from_fn(register))
    }

    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        for (i, register) in self.0.into_iter().enumerate() {
            // SAFETY: as above, and the caller vouches for `p`.
            unsafe { vst1q_f32(p.add(i * WIDTH), register) };
        }
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        // SAFETY: the trait is used only where the instruction set is enabled.
        let register = |i: usize| unsafe { vfmaq_f32(c.0[i], self.0[i], b.0[i]) };
        Self(std::array::from_fn(register))
    }

    #[inline(always)]
    fn add(self, b: Self) -> Self {
        // SAFETY: as above.
        let register = |i: usize| unsafe { vaddq_f32(self.0[i], b.0[i]) };
        Self(std::array::from_fn(register))
    }

    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        // SAFETY: as above.
        let register = |i: usize| unsafe { vsubq_f32(self.0[i], b.0[i]) };
        Self(std::array::from_fn(register))
    }

    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        // SAFETY: as above.
        let register = |i: usize| unsafe { vmulq_f32(self.0[i], b.0[i]) };
        Self(std::array::from_fn(register))
    }

    #[inline(always)]
    fn i32_to_f32(self) -> Self {
        // SAFETY: as above.
        let register = |bits| unsafe { vcvtq_f32_s32(vreinterpretq_s32_f32(bits)) };
        Self(self.0.map(register))
    }
}

impl DotBf16 for Neon {
    #[inline(always)]
    fn dot_bf16(self, b: Self, c: Self) -> Self {
        // Out of one lane of a register that need not be filled: a load to all lanes takes a place of the products.
        // SAFETY: the trait is used only where the instruction set is enabled.
        let pair = unsafe { vgetq_lane_f32::<0>(self.0[0]) };
        Self(std::array::from_fn(|i| {
            let mut sums = c.0[i];
            // SAFETY: the processor has the instruction, whose intrinsic is not stable. It reads and writes registers only.
            unsafe {
                asm!(
                    ".arch_extension bf16",
                    "bfdot {sums:v}.4s, {weights:v}.8h, {pair:v}.2h[0]",
                    sums = inout(vreg) sums,
                    weights = in(vreg) b.0[i],
                    pair = in(vreg) pair,
                    options(pure, nomem, nostack, preserves_flags),
                );
            }
            sums
        }))
    }
}

impl DotInt8 for Neon {
    #[inline(always)]
    fn dot_int8(self, b: Self, c: Self) -> Self {
        // As above.
        // SAFETY: as above.
        let four = unsafe { vgetq_lane_f32::<0>(self.0[0]) };
        Self(std::array::from_fn(|i| {
            let mut sums = c.0[i];
            // SAFETY: the processor has the instruction, whose intrinsic is not stable. It reads and writes registers only.
            unsafe {
                asm!(
                    ".arch_extension dotprod",
                    "sdot {sums:v}.4s, {weights:v}.16b, {four:v}.4b[0]",
                    sums = inout(vreg) sums,
                    weights = in(vreg) b.0[i],
                    four = in(vreg) four,
                    options(pure, nomem, nostack, preserves_flags),
                );
            }
            sums
        }))
    }
}
