//! Sixteen lanes of 32 bits, in the widest form that the processor has.

use std::sync::OnceLock;

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
}

/// Lanes with an instruction for products of bf16, two of which are in each lane.
pub(crate) trait DotBf16: Lanes {
    /// In every lane the sum of both products of `self` and `b`, plus that of `c`, an f32.
    fn dot_bf16(self, b: Self, c: Self) -> Self;
}

/// Lanes with products of bytes, four of which are in each lane.
pub(crate) trait DotInt8: Lanes {
    /// In every lane the sum of the four products of `self` (inputs, as the [`Int8Unit`] takes them) and `b` (weights, with
    /// a sign), plus that of `c`, an i32. Exact.
    fn dot_int8(self, b: Self, c: Self) -> Self;
}

/// Lanes with products of 16-bit whole numbers, two of which are in each lane.
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
    Portable,
}

impl InstructionSet {
    /// The best one of this machine.
    pub(crate) fn detect() -> Self {
        static DETECTED: OnceLock<InstructionSet> = OnceLock::new();
        *DETECTED.get_or_init(|| {
            #[cfg(target_arch = "x86_64")]
            {
                if is_x86_feature_detected!("avx512f") {
                    return Self::Avx512;
                }
                if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                    return Self::Avx2;
                }
            }
            Self::Portable
        })
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

/// How products of bf16 are computed where the processor has an instruction for them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Bf16Unit {
    /// vdpbf16ps on 512 bits.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Bf16Unit {
    /// The best one of this machine, if it has any.
    pub(crate) fn detect() -> Option<Self> {
        static DETECTED: OnceLock<Option<Bf16Unit>> = OnceLock::new();
        *DETECTED.get_or_init(|| {
            #[cfg(target_arch = "x86_64")]
            if InstructionSet::detect() == InstructionSet::Avx512
                && is_x86_feature_detected!("avx512bf16")
            {
                return Some(Self::Avx512);
            }
            None
        })
    }
}

/// How products of bytes are computed. All give the same sums, to the bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Int8Unit {
    /// As they are.
    Bytes(BytesUnit),
    /// As 16-bit whole numbers, by vpmaddwd. vpmaddubsw multiplies bytes, but only where the sign of one is moved to the
    /// other, and needs vpmaddwd for its sums all the same: together slower (1.4 times as fast as products of f32, on
    /// Zen 3, where vpmaddwd alone is nearly twice as fast).
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

/// What multiplies bytes as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BytesUnit {
    /// vpdpbusd on 512 bits.
    #[cfg(target_arch = "x86_64")]
    Avx512Vnni,
    Portable,
}

impl Int8Unit {
    /// The best one of this machine.
    pub(crate) fn detect() -> Self {
        static DETECTED: OnceLock<Int8Unit> = OnceLock::new();
        *DETECTED.get_or_init(|| {
            #[cfg(target_arch = "x86_64")]
            {
                let has_avx512 = InstructionSet::detect() == InstructionSet::Avx512;
                if has_avx512 && is_x86_feature_detected!("avx512vnni") {
                    return Self::Bytes(BytesUnit::Avx512Vnni);
                }
                if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                    return Self::Avx2;
                }
            }
            Self::Bytes(BytesUnit::Portable)
        })
    }

    /// As [`InstructionSet::tile_vectors`].
    pub(crate) fn tile_vectors(self) -> usize {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Bytes(BytesUnit::Avx512Vnni) => MOST_VECTORS,
            _ => 1,
        }
    }

    /// What is added to every input, for a unit that multiplies bytes without a sign with bytes that have one; the sums
    /// start lower by as much times their weights.
    pub(crate) fn input_offset(self) -> i32 {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Bytes(BytesUnit::Avx512Vnni) => 128,
            // No faster than with signs, but so every processor tests what the offset takes.
            Self::Bytes(BytesUnit::Portable) => 128,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => 0,
        }
    }

    /// Its name.
    pub(crate) fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Bytes(BytesUnit::Avx512Vnni) => "avx512vnni",
            Self::Bytes(BytesUnit::Portable) => "portable",
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => "avx2",
        }
    }
}

/// Which kernels this machine computes with: `avx512`, `avx2` or `portable`. Under another set sums are rounded otherwise.
pub fn instruction_set() -> &'static str {
    match InstructionSet::detect() {
        #[cfg(target_arch = "x86_64")]
        InstructionSet::Avx512 => "avx512",
        #[cfg(target_arch = "x86_64")]
        InstructionSet::Avx2 => "avx2",
        InstructionSet::Portable => "portable",
    }
}

/// No panel is wider, under any instruction set.
const MOST_VECTORS: usize = 4;

/// A panel's bias for sums that have none.
pub(crate) static NO_BIAS: [f32; MOST_VECTORS * LANES] = [0.0; MOST_VECTORS * LANES];

/// Bytes that a cache fetches together.
#[cfg(target_arch = "x86_64")]
const CACHE_LINE: usize = 64;

/// Asks for `values` to be brought into the second-level cache.
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
    #[cfg(not(target_arch = "x86_64"))]
    let _ = values;
}

/// The form that any processor has.
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

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Avx2, Avx512};

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m256, __m512, __m512bh, __m512i, _mm256_add_epi32, _mm256_add_ps, _mm256_castps_si256,
        _mm256_castsi256_ps, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_madd_epi16,
        _mm256_set1_epi32, _mm256_set1_ps, _mm256_storeu_ps, _mm256_sub_ps, _mm512_add_ps,
        _mm512_castps_si512, _mm512_castsi512_ps, _mm512_dpbf16_ps, _mm512_dpbusd_epi32,
        _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_set1_epi32, _mm512_set1_ps, _mm512_storeu_ps,
        _mm512_sub_ps,
    };

    use super::{DotBf16, DotInt8, DotInt16, Lanes};

    /// One 512-bit register.
    #[derive(Clone, Copy)]
    pub(crate) struct Avx512(__m512);

    impl Lanes for Avx512 {
        #[inline(always)]
        fn splat(v: f32) -> Self {
            // SAFETY: the trait is used only where the instruction set is enabled.
            Self(unsafe { _mm512_set1_ps(v) })
        }

        #[inline(always)]
        fn splat_bits(bits: u32) -> Self {
            // SAFETY: as above.
            Self(unsafe { _mm512_castsi512_ps(_mm512_set1_epi32(bits.cast_signed())) })
        }

        #[inline(always)]
        unsafe fn load(p: *const f32) -> Self {
            // SAFETY: as above, and the caller vouches for `p`.
            Self(unsafe { _mm512_loadu_ps(p) })
        }

        #[inline(always)]
        unsafe fn store(self, p: *mut f32) {
            // SAFETY: as above, and the caller vouches for `p`.
            unsafe { _mm512_storeu_ps(p, self.0) };
        }

        #[inline(always)]
        fn mul_add(self, b: Self, c: Self) -> Self {
            // SAFETY: the trait is used only where the instruction set is enabled.
            Self(unsafe { _mm512_fmadd_ps(self.0, b.0, c.0) })
        }

        #[inline(always)]
        fn add(self, b: Self) -> Self {
            // SAFETY: as above.
            Self(unsafe { _mm512_add_ps(self.0, b.0) })
        }

        #[inline(always)]
        fn sub(self, b: Self) -> Self {
            // SAFETY: as above.
            Self(unsafe { _mm512_sub_ps(self.0, b.0) })
        }
    }

    impl DotBf16 for Avx512 {
        #[inline(always)]
        fn dot_bf16(self, b: Self, c: Self) -> Self {
            // SAFETY: as above; both are 512 bits, of which any are 32 bf16.
            let pairs = |x: __m512| unsafe {
                std::mem::transmute::<__m512i, __m512bh>(_mm512_castps_si512(x))
            };
            // SAFETY: the trait is used only where the instruction set is enabled.
            Self(unsafe { _mm512_dpbf16_ps(c.0, pairs(self.0), pairs(b.0)) })
        }
    }

    impl DotInt8 for Avx512 {
        #[inline(always)]
        fn dot_int8(self, b: Self, c: Self) -> Self {
            // SAFETY: the trait is used only where the instruction set is enabled.
            Self(unsafe {
                let bits = |x: Self| _mm512_castps_si512(x.0);
                _mm512_castsi512_ps(_mm512_dpbusd_epi32(bits(c), bits(self), bits(b)))
            })
        }
    }

    /// Two 256-bit registers.
    #[derive(Clone, Copy)]
    pub(crate) struct Avx2(__m256, __m256);

    impl Lanes for Avx2 {
        #[inline(always)]
        fn splat(v: f32) -> Self {
            // SAFETY: the trait is used only where the instruction set is enabled.
            let v = unsafe { _mm256_set1_ps(v) };
            Self(v, v)
        }

        #[inline(always)]
        fn splat_bits(bits: u32) -> Self {
            // SAFETY: as above.
            let v = unsafe { _mm256_castsi256_ps(_mm256_set1_epi32(bits.cast_signed())) };
            Self(v, v)
        }

        #[inline(always)]
        unsafe fn load(p: *const f32) -> Self {
            // SAFETY: as above, and the caller vouches for `p`.
            unsafe { Self(_mm256_loadu_ps(p), _mm256_loadu_ps(p.add(8))) }
        }

        #[inline(always)]
        unsafe fn store(self, p: *mut f32) {
            // SAFETY: as above, and the caller vouches for `p`.
            unsafe {
                _mm256_storeu_ps(p, self.0);
                _mm256_storeu_ps(p.add(8), self.1);
            }
        }

        #[inline(always)]
        fn mul_add(self, b: Self, c: Self) -> Self {
            // SAFETY: the trait is used only where the instruction set is enabled.
            unsafe {
                Self(
                    _mm256_fmadd_ps(self.0, b.0, c.0),
                    _mm256_fmadd_ps(self.1, b.1, c.1),
                )
            }
        }

        #[inline(always)]
        fn add(self, b: Self) -> Self {
            // SAFETY: as above.
            unsafe { Self(_mm256_add_ps(self.0, b.0), _mm256_add_ps(self.1, b.1)) }
        }

        #[inline(always)]
        fn sub(self, b: Self) -> Self {
            // SAFETY: as above.
            unsafe { Self(_mm256_sub_ps(self.0, b.0), _mm256_sub_ps(self.1, b.1)) }
        }
    }

    impl DotInt16 for Avx2 {
        #[inline(always)]
        fn dot_int16(self, b: Self, c: Self) -> Self {
            let dot = |a: __m256, b: __m256, c: __m256| {
                // SAFETY: the trait is used only where the instruction set is enabled.
                unsafe {
                    let bits = |x: __m256| _mm256_castps_si256(x);
                    let products = _mm256_madd_epi16(bits(a), bits(b));
                    _mm256_castsi256_ps(_mm256_add_epi32(bits(c), products))
                }
            };
            Self(dot(self.0, b.0, c.0), dot(self.1, b.1, c.1))
        }
    }
}
