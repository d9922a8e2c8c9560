//! Sixteen lanes of 32 bits, in the widest form that the processor has.

use std::sync::OnceLock;

#[cfg(target_arch = "x86_64")]
pub(crate) mod amx;
#[cfg(target_arch = "aarch64")]
mod neon;
mod portable;
mod units;
#[cfg(target_arch = "x86_64")]
mod x86;

#[cfg(target_arch = "aarch64")]
pub(crate) use neon::Neon;
pub(crate) use portable::Portable;
pub(crate) use units::{Bf16Unit, BytesUnit, Int8Unit};
#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Avx2, Avx512};

/// Lanes in one vector.
pub(crate) const LANES: usize = 16;

/// Sixteen f32 that are computed with together, or what else has as many bits.
///
/// The methods must be called only where the instruction set of the implementing type is enabled.
pub(crate) trait Lanes: Copy {
    /// All lanes `v`.
    fn splat(v: f32) -> Self;
    /// All lanes the 32 bits of `bits`.
    fn splat_bits(bits: u32) -> Self;
    /// # Safety
    /// Sixteen f32 must be readable at `p`.
    unsafe fn load(p: *const f32) -> Self;
    /// # Safety
    /// Sixteen f32 must be writable at `p`.
    unsafe fn store(self, p: *mut f32);
    /// `self * b + c`.
    fn mul_add(self, b: Self, c: Self) -> Self;
    /// `self + b`.
    fn add(self, b: Self) -> Self;
    /// `self - b`.
    fn sub(self, b: Self) -> Self;
    /// `self * b`.
    fn mul(self, b: Self) -> Self;
    /// The bits of the lanes as i32, converted to f32.
    fn i32_to_f32(self) -> Self;
}

/// Lanes with an instruction for products of bf16, two of which are in each lane.
pub(crate) trait DotBf16: Lanes {
    /// In every lane the sum of both products of `self`, whose lanes are all the same, and `b`, plus that of `c`, an f32.
    fn dot_bf16(self, b: Self, c: Self) -> Self;
}

/// Lanes with products of bytes, four of which are in each lane.
pub(crate) trait DotInt8: Lanes {
    /// In every lane the sum of the four products of `self` (inputs, as the [`Int8Unit`] takes them, the same in all lanes)
    /// and `b` (weights, with a sign), plus that of `c`, an i32. Exact.
    fn dot_int8(self, b: Self, c: Self) -> Self;
}

/// Lanes with products of 16-bit whole numbers, two of which are in each lane.
#[cfg(target_arch = "x86_64")]
pub(crate) trait DotInt16: Lanes {
    /// In every lane the sum of both products of `self` and `b`, plus that of `c`, an i32. Exact.
    fn dot_int16(self, b: Self, c: Self) -> Self;
}

/// Instruction sets with kernels of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InstructionSet {
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "aarch64")]
    Neon,
    Portable,
}

impl InstructionSet {
    /// Those of this architecture, the best one first.
    pub(crate) const ALL: &[Self] = &[
        #[cfg(target_arch = "x86_64")]
        Self::Avx512,
        #[cfg(target_arch = "x86_64")]
        Self::Avx2,
        #[cfg(target_arch = "aarch64")]
        Self::Neon,
        Self::Portable,
    ];

    /// The best one of this machine.
    pub(crate) fn detect() -> Self {
        static DETECTED: OnceLock<InstructionSet> = OnceLock::new();
        *DETECTED.get_or_init(|| {
            let mut all = Self::ALL.iter().copied();
            all.find(|set| set.is_there()).unwrap_or(Self::Portable)
        })
    }

    /// Whether this machine has it.
    pub(crate) fn is_there(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => is_x86_feature_detected!("avx512f"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(target_arch = "aarch64")]
            Self::Neon => std::arch::is_aarch64_feature_detected!("neon"),
            Self::Portable => true,
        }
    }

    /// What users are told.
    pub(crate) fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => "avx512",
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => "avx2",
            #[cfg(target_arch = "aarch64")]
            Self::Neon => "neon",
            Self::Portable => "portable",
        }
    }

    /// Vectors of output channels that one tile of the kernels covers at most, limited by the
    /// number of registers.
    pub(crate) fn tile_vectors(self) -> usize {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => MOST_VECTORS,
            _ => 1,
        }
    }
}

/// No panel is wider, under any instruction set.
const MOST_VECTORS: usize = 4;

/// A panel's bias for sums that have none.
pub(crate) static NO_BIAS: [f32; MOST_VECTORS * LANES] = [0.0; MOST_VECTORS * LANES];

/// Bytes that a cache fetches together. Some processors have lines of 128 and are asked twice.
pub(crate) const CACHE_LINE: usize = 64;

/// Asks for `values` to be brought into the second-level cache.
#[inline(always)]
pub(crate) fn prefetch<T>(values: &[T]) {
    #[cfg(target_arch = "x86_64")]
    for line in values.chunks(CACHE_LINE / size_of::<T>().max(1)) {
        // SAFETY: every x86-64 has the instruction, and it never faults.
        unsafe {
            std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T1 }>(
                line.as_ptr().cast(),
            );
        }
    }
    #[cfg(target_arch = "aarch64")]
    for line in values.chunks(CACHE_LINE / size_of::<T>().max(1)) {
        // SAFETY: every 64-bit Arm has the instruction, and it never faults.
        unsafe {
            std::arch::asm!(
                "prfm pldl2keep, [{line}]",
                line = in(reg) line.as_ptr(),
                options(nostack, readonly, preserves_flags),
            );
        }
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let _ = values;
}
