//! Number formats that packed weights are kept in. Sums are always of f32.

use bytemuck::Pod;
use half::bf16;

use super::simd::Lanes;

/// The number format of packed weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PackedFormat {
    /// 32-bit floats.
    #[default]
    F32,
    /// The upper half of a 32-bit float: half the memory, which is what bounds large models.
    /// Activations stay 32-bit, so results are nearer to those in f32 than where both are rounded.
    Bf16,
}

/// A packed weight.
pub(crate) trait Element: Pod + Send + Sync + std::fmt::Debug {
    fn from_f32(value: f32) -> Self;

    fn to_f32(self) -> f32;

    /// # Safety
    /// Sixteen elements must be readable at `p`, and the instruction set of `L` enabled.
    unsafe fn load<L: Lanes>(p: *const Self) -> L;
}

impl Element for f32 {
    fn from_f32(value: f32) -> Self {
        value
    }

    fn to_f32(self) -> f32 {
        self
    }

    #[inline(always)]
    unsafe fn load<L: Lanes>(p: *const Self) -> L {
        // SAFETY: as for this function.
        unsafe { L::load(p) }
    }
}

impl Element for bf16 {
    fn from_f32(value: f32) -> Self {
        bf16::from_f32(value)
    }

    fn to_f32(self) -> f32 {
        bf16::to_f32(self)
    }

    #[inline(always)]
    unsafe fn load<L: Lanes>(p: *const Self) -> L {
        // SAFETY: as for this function; a bf16 is its sixteen bits.
        unsafe { L::load_upper_halves(p.cast()) }
    }
}
