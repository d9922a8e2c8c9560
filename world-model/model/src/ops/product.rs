//! How inputs are multiplied with packed weights: what one step of the kernels' inner loop reads, and what it adds to the
//! sums.

use half::bf16;

use super::element::Element;
use super::kernel::Row;
#[cfg(target_arch = "aarch64")]
use super::simd::Neon;
#[cfg(target_arch = "x86_64")]
use super::simd::amx::Bf16Tiles;
#[cfg(target_arch = "x86_64")]
use super::simd::{Avx2, Avx512};
use super::simd::{Bf16Unit, DotBf16, InstructionSet, Lanes, Portable};

/// The number formats of a product. The sums are f32.
///
/// One step takes a group of neighbouring inputs, and for each output as many weights, which lie side by side
/// ([`Element::GROUP`]).
pub(crate) trait Product: Copy + Send + Sync + 'static {
    /// What the inputs are.
    type Input: Element;
    /// What the weights are.
    type Weight: Element;
    /// What of a processor computes it.
    type Unit: Copy + Send + Sync;

    /// Computes a row.
    ///
    /// # Safety
    /// All pointers of `row` must be valid for what their comments say, and the processor must have `unit`.
    unsafe fn run(row: &Row<Self>, unit: Self::Unit);
}

/// A step of a product on the lanes `L`, of which each holds a group or a sum.
///
/// The methods must be called only where the instruction set of `L` is enabled.
pub(crate) trait Step<L: Lanes>: Product {
    /// A group of inputs, in all lanes.
    ///
    /// # Safety
    /// A group must be readable at `input`.
    unsafe fn splat(input: *const Self::Input) -> L;

    /// The groups of weights of [`LANES`](super::simd::LANES) outputs.
    ///
    /// # Safety
    /// As many groups must be readable at `weights`.
    unsafe fn load(weights: *const Self::Weight) -> L;

    /// `sums` plus the products of inputs and weights.
    fn add(inputs: L, weights: L, sums: L) -> L;
}

/// f32 times f32.
#[derive(Clone, Copy, Debug)]
pub(crate) struct F32;

impl Product for F32 {
    type Input = f32;
    type Weight = f32;
    type Unit = InstructionSet;

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
