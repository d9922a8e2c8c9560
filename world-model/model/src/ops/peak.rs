//! What the processor could compute at most.

use std::hint::black_box;
use std::time::Instant;

use super::element::{Element, PackedFormat};
#[cfg(target_arch = "x86_64")]
use super::product::WidenedInt8;
use super::product::{Bf16, F32, Int8, Product, Step};
#[cfg(target_arch = "x86_64")]
use super::simd::{Avx2, Avx512};
use super::simd::{Bf16Unit, BytesUnit, InstructionSet, Int8Unit, LANES, Lanes, Portable};

/// Sums that are added to in turns: more than a processor's latency of an addition times its units, and no more than fit
/// into its registers, with thirty-two of a vector each and with sixteen of half a vector.
#[cfg(target_arch = "x86_64")]
const WIDE: usize = 12;
const NARROW: usize = 6;
const ROUNDS: usize = 200_000;

/// Operations a second that the products of a kernel for weights of `format` have at most, measured on the calling thread:
/// multiplications and additions of values that are in registers. None where the processor has no
/// products of the format.
pub fn peak_rate(format: PackedFormat) -> Option<f64> {
    let start = Instant::now();
    let steps = match format {
        PackedFormat::F32 => f32_steps(InstructionSet::detect()),
        PackedFormat::Bf16 => bf16_steps(Bf16Unit::detect()?),
        PackedFormat::Int8 => int8_steps(Int8Unit::detect()),
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
        InstructionSet::Portable => steps::<F32, Portable, NARROW>(1.0, 1e-9),
    }
}

fn bf16_steps(unit: Bf16Unit) -> usize {
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bf16")]
    fn avx512() -> usize {
        let [one, small] = [1.0, 1e-9].map(<half::bf16 as Element>::from_f32);
        steps::<Bf16, Avx512, WIDE>(one, small)
    }

    match unit {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the processor was found to have these instructions.
        Bf16Unit::Avx512 => unsafe { avx512() },
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
        Int8Unit::Bytes(BytesUnit::Avx512Vnni) => unsafe { avx512_vnni() },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Int8Unit::Avx2 => unsafe { avx2() },
        Int8Unit::Bytes(BytesUnit::Portable) => steps::<Int8, Portable, NARROW>(1, 1),
    }
}

/// Adds products to `SUMS` sums in turns, of inputs that are read anew each time, as the kernels do: of values that stay the
/// same the compiler would compute the products once.
#[inline(always)]
fn steps<P: Step<L>, L: Lanes, const SUMS: usize>(input: P::Input, weight: P::Weight) -> usize {
    let group = <P as Product>::Weight::GROUP;
    let (inputs, weights) = (vec![input; SUMS * group], vec![weight; LANES * group]);
    // SAFETY: so many weights were written.
    let weights = black_box(unsafe { P::load(weights.as_ptr()) });
    let mut sums = [L::splat(0.0); SUMS];
    for _ in 0..ROUNDS {
        let inputs = black_box(inputs.as_ptr());
        for (i, sum) in sums.iter_mut().enumerate() {
            // SAFETY: so many inputs were written.
            let input = unsafe { P::splat(inputs.add(i * group)) };
            *sum = P::add(input, weights, *sum);
        }
    }
    black_box(sums);
    ROUNDS * SUMS * LANES * group
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_processor_computes_something() {
        for format in [PackedFormat::F32, PackedFormat::Int8] {
            assert!(peak_rate(format).is_some_and(|rate| rate > 1e6));
        }
        assert_eq!(
            peak_rate(PackedFormat::Bf16).is_some(),
            Bf16Unit::detect().is_some()
        );
    }
}
