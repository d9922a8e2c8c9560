//! Lanes in the registers of x86-64.

use std::arch::x86_64::{
    __m256, __m512, __m512bh, __m512i, _mm256_add_epi32, _mm256_add_ps, _mm256_castps_si256,
    _mm256_castsi256_ps, _mm256_cvtepi32_ps, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_madd_epi16,
    _mm256_mul_ps, _mm256_set1_epi32, _mm256_set1_ps, _mm256_storeu_ps, _mm256_sub_ps,
    _mm512_add_ps, _mm512_castps_si512, _mm512_castsi512_ps, _mm512_cvtepi32_ps, _mm512_dpbf16_ps,
    _mm512_dpbusd_epi32, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_mul_ps, _mm512_set1_epi32,
    _mm512_set1_ps, _mm512_storeu_ps, _mm512_sub_ps,
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

    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        // SAFETY: as above.
        Self(unsafe { _mm512_mul_ps(self.0, b.0) })
    }

    #[inline(always)]
    fn i32_to_f32(self) -> Self {
        // SAFETY: as above.
        Self(unsafe { _mm512_cvtepi32_ps(_mm512_castps_si512(self.0)) })
    }
}

impl DotBf16 for Avx512 {
    #[inline(always)]
    fn dot_bf16(self, b: Self, c: Self) -> Self {
        // SAFETY: as above; both are 512 bits, of which any are 32 bf16.
        let pairs =
            |x: __m512| unsafe { std::mem::transmute::<__m512i, __m512bh>(_mm512_castps_si512(x)) };
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

    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        // SAFETY: as above.
        unsafe { Self(_mm256_mul_ps(self.0, b.0), _mm256_mul_ps(self.1, b.1)) }
    }

    #[inline(always)]
    fn i32_to_f32(self) -> Self {
        // SAFETY: as above.
        let of = |bits| unsafe { _mm256_cvtepi32_ps(_mm256_castps_si256(bits)) };
        Self(of(self.0), of(self.1))
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
