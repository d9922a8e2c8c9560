//! Products of packed weights in each number format: f32, bf16 and int8.

use half::bf16;

use super::kernel::{Product, Row, Scales, Step};
#[cfg(target_arch = "aarch64")]
use super::simd::Neon;
#[cfg(target_arch = "x86_64")]
use super::simd::amx::{Bf16Tiles, Int8Tiles};
#[cfg(target_arch = "x86_64")]
use super::simd::{Avx2, Avx512, DotInt16};
use super::simd::{Bf16Unit, BytesUnit, DotBf16, DotInt8, InstructionSet, LANES, Lanes, Portable};

/// f32 times f32.
#[derive(Clone, Copy, Debug)]
pub(crate) struct F32;

impl Product for F32 {
    type Input = f32;
    type Weight = f32;
    type Unit = InstructionSet;
    type Scales = ();

    unsafe fn run(row: &Row<Self>, set: InstructionSet) {
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f")]
        unsafe fn avx512(row: &Row<F32>) {
            // SAFETY: as for `run`.
            unsafe { row.wide_tiles::<Avx512>() }
        }

        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2(row: &Row<F32>) {
            // SAFETY: as for `run`.
            unsafe { row.tiles::<Avx2, 6, 1>() }
        }

        // SAFETY: the caller vouches for the pointers and the instruction set.
        unsafe {
            match set {
                #[cfg(target_arch = "x86_64")]
                InstructionSet::Avx512 => avx512(row),
                #[cfg(target_arch = "x86_64")]
                InstructionSet::Avx2 => avx2(row),
                // Of 32 registers 24 are sums, four weights.
                #[cfg(target_arch = "aarch64")]
                InstructionSet::Neon => row.tiles::<Neon, 6, 1>(),
                InstructionSet::Portable => row.tiles::<Portable, 4, 1>(),
            }
        }
    }
}

impl<L: Lanes> Step<L> for F32 {
    #[inline(always)]
    unsafe fn splat(input: *const f32) -> L {
        // SAFETY: as for this function.
        L::splat(unsafe { *input })
    }

    #[inline(always)]
    unsafe fn load(weights: *const f32) -> L {
        // SAFETY: as for this function.
        unsafe { L::load(weights) }
    }

    #[inline(always)]
    fn add(inputs: L, weights: L, sums: L) -> L {
        inputs.mul_add(weights, sums)
    }
}

/// bf16 times bf16, two at once, for processors that have the instruction. Inputs were rounded to bf16.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bf16;

impl Product for Bf16 {
    type Input = bf16;
    type Weight = bf16;
    type Unit = Bf16Unit;
    type Scales = ();

    unsafe fn run(row: &Row<Self>, unit: Bf16Unit) {
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f,avx512bf16")]
        unsafe fn avx512(row: &Row<Bf16>) {
            // SAFETY: as for `run`.
            unsafe { row.wide_tiles::<Avx512>() }
        }

        /// What is around the tiles, in wide registers.
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f")]
        unsafe fn amx(row: &Row<Bf16>) {
            // SAFETY: as for `run`.
            unsafe { row.amx_tiles::<Bf16Tiles>() }
        }

        // SAFETY: the caller vouches for the pointers and the instructions.
        unsafe {
            match unit {
                #[cfg(target_arch = "x86_64")]
                Bf16Unit::Amx => match InstructionSet::detect() {
                    InstructionSet::Avx512 => amx(row),
                    _ => row.amx_tiles::<Bf16Tiles>(),
                },
                #[cfg(target_arch = "x86_64")]
                Bf16Unit::Avx512 => avx512(row),
                #[cfg(target_arch = "aarch64")]
                Bf16Unit::Neon => row.tiles::<Neon, 6, 1>(),
            }
        }
    }
}

impl<L: DotBf16> Step<L> for Bf16 {
    #[inline(always)]
    unsafe fn splat(input: *const bf16) -> L {
        // SAFETY: as for this function; the read needs no alignment.
        L::splat_bits(unsafe { input.cast::<u32>().read_unaligned() })
    }

    #[inline(always)]
    unsafe fn load(weights: *const bf16) -> L {
        // SAFETY: as for this function; a lane is two bf16.
        unsafe { L::load(weights.cast()) }
    }

    #[inline(always)]
    fn add(inputs: L, weights: L, sums: L) -> L {
        inputs.dot_bf16(weights, sums)
    }
}

/// Bytes times bytes, four at once. Sums are whole numbers, and exact.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Int8;

/// What makes outputs of sums of whole numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WholeScales {
    /// What an input of 1 stands for, for each pixel.
    pub inputs: *const f32,
    /// What a weight of 1 stands for, for each output: `vectors * LANES` values.
    pub weights: *const f32,
    /// Where the sums start, `vectors * LANES` values: [`Int8Unit::input_offset`](super::simd::Int8Unit::input_offset).
    pub starts: *const i32,
}

impl Scales for WholeScales {
    #[inline(always)]
    fn starts(&self, _: *const f32) -> *const f32 {
        self.starts.cast()
    }

    /// In one order and without fused operations, so that every processor gives the same bits.
    #[inline(always)]
    unsafe fn outputs<L: Lanes>(
        &self,
        bias: *const f32,
        (pixel, vector): (usize, usize),
        sums: L,
    ) -> L {
        // SAFETY: as for this function.
        let (input, weights, bias) = unsafe {
            let at = vector * LANES;
            let input = L::splat(*self.inputs.add(pixel));
            (input, L::load(self.weights.add(at)), L::load(bias.add(at)))
        };
        sums.i32_to_f32().mul(input.mul(weights)).add(bias)
    }
}

impl Product for Int8 {
    type Input = i8;
    type Weight = i8;
    type Unit = BytesUnit;
    type Scales = WholeScales;

    unsafe fn run(row: &Row<Self>, unit: BytesUnit) {
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f,avx512vnni")]
        unsafe fn avx512_vnni(row: &Row<Int8>) {
            // SAFETY: as for `run`.
            unsafe { row.wide_tiles::<Avx512>() }
        }

        /// As in [`Bf16`]: what is around the tiles, in wide registers.
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f")]
        unsafe fn amx(row: &Row<Int8>) {
            // SAFETY: as for `run`.
            unsafe { row.amx_tiles::<Int8Tiles>() }
        }

        // SAFETY: the caller vouches for the pointers and the instructions.
        unsafe {
            match unit {
                #[cfg(target_arch = "x86_64")]
                BytesUnit::Amx => match InstructionSet::detect() {
                    InstructionSet::Avx512 => amx(row),
                    _ => row.amx_tiles::<Int8Tiles>(),
                },
                #[cfg(target_arch = "x86_64")]
                BytesUnit::Avx512Vnni => avx512_vnni(row),
                #[cfg(target_arch = "aarch64")]
                BytesUnit::Neon => row.tiles::<Neon, 6, 1>(),
                BytesUnit::Portable => row.tiles::<Portable, 4, 1>(),
            }
        }
    }
}

impl<L: DotInt8> Step<L> for Int8 {
    #[inline(always)]
    unsafe fn splat(input: *const i8) -> L {
        // SAFETY: as for this function; the read needs no alignment.
        L::splat_bits(unsafe { input.cast::<u32>().read_unaligned() })
    }

    #[inline(always)]
    unsafe fn load(weights: *const i8) -> L {
        // SAFETY: as for this function; a lane is four bytes.
        unsafe { L::load(weights.cast()) }
    }

    #[inline(always)]
    fn add(inputs: L, weights: L, sums: L) -> L {
        inputs.dot_int8(weights, sums)
    }
}

/// Bytes times bytes that were widened to 16 bits, two at once. Sums are those of [`Int8`].
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub(crate) struct WidenedInt8;

#[cfg(target_arch = "x86_64")]
impl Product for WidenedInt8 {
    type Input = i16;
    type Weight = i16;
    /// AVX2.
    type Unit = ();
    type Scales = WholeScales;

    unsafe fn run(row: &Row<Self>, (): ()) {
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2(row: &Row<WidenedInt8>) {
            // SAFETY: as for `run`.
            unsafe { row.tiles::<Avx2, 6, 1>() }
        }

        // SAFETY: the caller vouches for the pointers and the instructions.
        unsafe { avx2(row) }
    }
}

#[cfg(target_arch = "x86_64")]
impl<L: DotInt16> Step<L> for WidenedInt8 {
    #[inline(always)]
    unsafe fn splat(input: *const i16) -> L {
        // SAFETY: as for this function; the read needs no alignment.
        L::splat_bits(unsafe { input.cast::<u32>().read_unaligned() })
    }

    #[inline(always)]
    unsafe fn load(weights: *const i16) -> L {
        // SAFETY: as for this function; a lane is two numbers.
        unsafe { L::load(weights.cast()) }
    }

    #[inline(always)]
    fn add(inputs: L, weights: L, sums: L) -> L {
        inputs.dot_int16(weights, sums)
    }
}
