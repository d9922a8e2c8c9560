//! What the processor could compute at most.

use std::hint::black_box;
use std::time::Instant;

use super::element::Element;
use super::kernel::{Product, Step};
#[cfg(target_arch = "x86_64")]
use super::product::WidenedInt8;
use super::product::{Bf16, F32, Int8};
#[cfg(target_arch = "aarch64")]
use super::simd::Neon;
#[cfg(target_arch = "x86_64")]
use super::simd::amx::{
    Bf16Tiles, Int8Tiles, Operands, ROW_BYTES, ROWS, Shapes, Sums, TileProduct,
};
#[cfg(target_arch = "x86_64")]
use super::simd::{Avx2, Avx512};
use super::simd::{Bf16Unit, BytesUnit, InstructionSet, Int8Unit, LANES, Lanes, Portable};
use crate::NumberFormat;

/// Inputs and weights of the tiles that are added to, as in the kernels: their sums are more than a processor's latency of an
/// addition times its units, and fit into its registers. With an input for every product, Zen 4 reads inputs as long as it
/// multiplies.
const INPUTS: usize = 6;
#[cfg(target_arch = "x86_64")]
const WIDE: usize = 4;
const NARROW: usize = 1;
const ROUNDS: usize = 200_000;

/// Operations a second that the products of a kernel for weights of `format` have at most, measured on the calling thread:
/// multiplications and additions of values that are in registers. None where the processor has no
/// products of the format.
pub fn peak_rate(format: NumberFormat) -> Option<f64> {
    let start = Instant::now();
    let steps = match format {
        NumberFormat::F32 => f32_steps(InstructionSet::detect()),
        NumberFormat::Bf16 => bf16_steps(Bf16Unit::detect()?),
        NumberFormat::Int8 => int8_steps(Int8Unit::detect()),
    };
    Some((2 * steps) as f64 / start.elapsed().as_secs_f64())
}

/// Computes; how many products.
fn f32_steps(set: InstructionSet) -> usize {
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f")]
    fn avx512() -> usize {
        steps::<F32, Avx512, WIDE>(1.0, 1e-9)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn avx2() -> usize {
        steps::<F32, Avx2, NARROW>(1.0, 1e-9)
    }

    match set {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the processor was found to have these instructions.
        InstructionSet::Avx512 => unsafe { avx512() },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        InstructionSet::Avx2 => unsafe { avx2() },
        #[cfg(target_arch = "aarch64")]
        InstructionSet::Neon => steps::<F32, Neon, NARROW>(1.0, 1e-9),
        InstructionSet::Portable => steps::<F32, Portable, NARROW>(1.0, 1e-9),
    }
}

fn bf16_steps(unit: Bf16Unit) -> usize {
    let [one, small] = [1.0, 1e-9].map(<half::bf16 as Element>::from_f32);

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bf16")]
    fn avx512(input: half::bf16, weight: half::bf16) -> usize {
        steps::<Bf16, Avx512, WIDE>(input, weight)
    }

    match unit {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the processor was found to have these instructions.
        Bf16Unit::Amx => unsafe { tile_steps::<Bf16Tiles>(ROUNDS, half::bf16::GROUP) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Bf16Unit::Avx512 => unsafe { avx512(one, small) },
        #[cfg(target_arch = "aarch64")]
        Bf16Unit::Neon => steps::<Bf16, Neon, NARROW>(one, small),
    }
}

fn int8_steps(unit: Int8Unit) -> usize {
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512vnni")]
    fn avx512_vnni() -> usize {
        steps::<Int8, Avx512, WIDE>(1, 1)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn avx2() -> usize {
        steps::<WidenedInt8, Avx2, NARROW>(1, 1)
    }

    match unit {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the processor was found to have these instructions.
        Int8Unit::Bytes(BytesUnit::Amx) => unsafe { tile_steps::<Int8Tiles>(ROUNDS, i8::GROUP) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Int8Unit::Bytes(BytesUnit::Avx512Vnni) => unsafe { avx512_vnni() },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Int8Unit::Avx2 => unsafe { avx2() },
        #[cfg(target_arch = "aarch64")]
        Int8Unit::Bytes(BytesUnit::Neon) => steps::<Int8, Neon, NARROW>(1, 1),
        Int8Unit::Bytes(BytesUnit::Portable) => steps::<Int8, Portable, NARROW>(1, 1),
    }
}

/// Adds products to the sums of a tile in turns, of inputs that are read anew each time, as the kernels do: of values that
/// stay the same the compiler would compute the products once.
#[inline(always)]
fn steps<P: Step<L>, L: Lanes, const WEIGHTS: usize>(input: P::Input, weight: P::Weight) -> usize {
    let group = <P as Product>::Weight::GROUP;
    let (inputs, weights) = (vec![input; INPUTS * group], vec![weight; LANES * group]);
    // SAFETY: so many weights were written.
    let weights = black_box([unsafe { P::load(weights.as_ptr()) }; WEIGHTS]);
    let mut sums = [[L::splat(0.0); WEIGHTS]; INPUTS];
    for _ in 0..ROUNDS {
        let inputs = black_box(inputs.as_ptr());
        for (i, sums) in sums.iter_mut().enumerate() {
            // SAFETY: so many inputs were written.
            let input = unsafe { P::splat(inputs.add(i * group)) };
            for (sum, weights) in sums.iter_mut().zip(weights) {
                *sum = P::add(input, weights, *sum);
            }
        }
    }
    black_box(sums);
    ROUNDS * INPUTS * WEIGHTS * LANES * group
}

/// Four products of tiles a round, of loads from a first-level cache, which take half the time of the products.
///
/// # Safety
/// The processor must have the tiles and `T`, and the system must let this process use them.
#[cfg(target_arch = "x86_64")]
unsafe fn tile_steps<T: TileProduct>(rounds: usize, group: usize) -> usize {
    let (input, weights) = ([0_u8; ROW_BYTES], [0_u8; 2 * ROW_BYTES]);
    let operands = Operands {
        // All rows are the same.
        inputs: [input.as_ptr(); 2],
        input_pitch: 0,
        weights: weights.as_ptr(),
        weight_pitch: 0,
        steps: 1,
        runs: rounds,
        next_inputs: ROW_BYTES.wrapping_neg(),
        next_weights: 0,
    };
    let mut sums = Sums([[[[0.0; LANES]; ROWS]; 2]; 2]);
    // SAFETY: as for this function; a row is read from each pointer, from weights two.
    unsafe {
        let shapes = Shapes::load(ROWS);
        T::add_two(&shapes, &operands, &mut sums);
    }
    black_box(sums);
    rounds * 4 * ROWS * LANES * ROWS * group
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(all(target_arch = "x86_64", target_os = "linux"))]
    #[test]
    fn products_of_tiles_are_counted() {
        assert!(Bf16Unit::Amx.can_be_tested() && Int8Unit::Bytes(BytesUnit::Amx).can_be_tested());
        // SAFETY: the processor has the tiles, or they are emulated.
        unsafe {
            let (bf16, int8) = (half::bf16::GROUP, i8::GROUP);
            assert_eq!(tile_steps::<Bf16Tiles>(3, bf16), 3 * 4 * 16 * 16 * 32);
            assert_eq!(tile_steps::<Int8Tiles>(2, int8), 2 * 4 * 16 * 16 * 64);
        }
    }

    #[test]
    fn a_processor_computes_something() {
        for format in [NumberFormat::F32, NumberFormat::Int8] {
            assert!(peak_rate(format).is_some_and(|rate| rate > 1e6));
        }
        assert_eq!(
            peak_rate(NumberFormat::Bf16).is_some(),
            Bf16Unit::detect().is_some()
        );
    }
}
