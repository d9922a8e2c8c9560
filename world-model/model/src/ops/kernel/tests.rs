//! Every instruction set and unit of this architecture that the machine has, against sums of f64.

use half::bf16;

use super::*;
use crate::ops::int8_panels::tests::check_unit as check_int8;
use crate::ops::product::{Bf16, F32};
use crate::ops::simd::{Bf16Unit, InstructionSet, Int8Unit};

/// Inputs of a pixel, rows and columns of taps: less than a tile of AMX takes at once, as much, and both.
const TAPS: [(usize, usize, usize); 4] = [(6, 3, 3), (64, 1, 1), (34, 2, 3), (2, 1, 1)];

fn numbers(count: usize, seed: usize) -> Vec<f32> {
    (0..count)
        .map(|i| ((i * 7919 + seed * 104_729) % 2003) as f32 / 1001.0 - 1.0)
        .collect()
}

/// Sums of f32 that are f64 otherwise.
struct Sum {
    value: f64,
    absolute: f64,
    terms: usize,
}

impl Sum {
    fn of(terms: impl Iterator<Item = f64>) -> Self {
        let mut sum = Self {
            value: 0.0,
            absolute: 0.0,
            terms: 0,
        };
        for term in terms {
            sum.value += term;
            sum.absolute += term.abs();
            sum.terms += 1;
        }
        sum
    }

    /// Each addition rounds by up to a unit in the last place of f32 (to odd, as bfdot does; by half of one to the
    /// nearest), in both directions, so that n of them add up to about sqrt(n).
    fn tolerance(&self) -> f64 {
        self.absolute * f64::from(f32::EPSILON) * (self.terms as f64).sqrt()
    }
}

/// Rows of every size, by `unit`, with panels of up to `most_vectors`.
fn check_rows<P: Product<Input = T, Weight = T, Scales = ()>, T: Element + Into<f32>>(
    what: &str,
    unit: P::Unit,
    most_vectors: usize,
) {
    for (inputs, tap_rows, tap_columns) in TAPS {
        for vectors in 1..=most_vectors {
            // Less than a tile, whole tiles, and a rest; whole and partial vectors.
            for (pixels, channels) in [
                (1, vectors * LANES),
                (16, vectors * LANES - 3),
                (19, vectors * LANES),
                (50, vectors * LANES - 15),
            ] {
                let taps = (inputs, tap_rows, tap_columns);
                check_row::<P, T>(what, unit, taps, vectors, (pixels, channels));
            }
        }
    }
}

fn check_row<P: Product<Input = T, Weight = T, Scales = ()>, T: Element + Into<f32>>(
    what: &str,
    unit: P::Unit,
    (inputs, tap_rows, tap_columns): (usize, usize, usize),
    vectors: usize,
    (pixels, channels): (usize, usize),
) {
    let (run, width) = (inputs * tap_columns, vectors * LANES);
    let pitch = (pixels + tap_columns - 1) * inputs;
    let rounded = |count, seed| -> Vec<T> {
        let values = numbers(count, seed).into_iter();
        values.map(T::from_f32).collect()
    };
    let input = rounded(tap_rows * pitch, 1);
    let panel = rounded(tap_rows * run * width, 2);
    let bias = numbers(width, 3);
    // The residual may be the output itself.
    let mut output = numbers(pixels * channels + 1, 4);
    let residual = output.clone();
    let mask = numbers(pixels * channels, 5);
    let row = Row::<P> {
        input: input.as_ptr(),
        input_step: inputs,
        tap_pitch: pitch,
        tap_rows,
        run,
        panel: panel.as_ptr(),
        vectors,
        bias: bias.as_ptr(),
        scales: (),
        pixels,
        output: output.as_mut_ptr(),
        residual: output.as_ptr(),
        mask: mask.as_ptr(),
        output_step: channels,
        channels,
        relu: true,
        accumulates: false,
        prefetch: super::Prefetch::NOTHING,
    };
    // SAFETY: all slices have the lengths that the fields promise, and the caller found `unit`.
    unsafe { row.run(unit) };
    let what = format!("{what}: {tap_rows} x {run} inputs, {channels} of {vectors} vectors");
    let as_f64 = |value: T| f64::from(value.into());
    for (at, found) in output.iter().take(pixels * channels).enumerate() {
        let (x, c) = (at / channels, at % channels);
        let products = (0..tap_rows * run).map(|k| {
            // In a panel the inputs of a group lie side by side.
            let weight = (k / T::GROUP * width + c) * T::GROUP + k % T::GROUP;
            let input = k / run * pitch + x * inputs + k % run;
            (input, weight)
        });
        let products = products.map(|(i, w)| as_f64(input[i]) * as_f64(panel[w]));
        let other = [f64::from(bias[c]), f64::from(residual[at])];
        let sum = Sum::of(other.into_iter().chain(products));
        let expected = if mask[at] > 0.0 {
            sum.value.max(0.0)
        } else {
            0.0
        };
        let error = (expected - f64::from(*found)).abs();
        assert!(
            error <= sum.tolerance(),
            "{what}: {found} at pixel {x} of {pixels}, channel {c}; expected {expected}"
        );
    }
    assert_eq!(output.last(), residual.last(), "{what}: wrote too far");
}

/// Says which of the architecture's paths were tested here, and which this processor has not.
#[test]
fn every_path_that_this_processor_has_is_tested() {
    for set in InstructionSet::ALL.iter().copied() {
        let can_be_tested = set.is_there();
        if can_be_tested {
            check_rows::<F32, f32>(set.name(), set, set.tile_vectors());
            check_outer_products(set);
        }
        say(set.name(), can_be_tested, can_be_tested);
    }
    for unit in Bf16Unit::ALL.iter().copied() {
        if unit.can_be_tested() {
            let most_vectors = match unit {
                #[cfg(target_arch = "aarch64")]
                Bf16Unit::Neon => InstructionSet::Neon.tile_vectors(),
                // Of panels that were cut for AVX-512.
                #[cfg(target_arch = "x86_64")]
                Bf16Unit::Amx | Bf16Unit::Avx512 => InstructionSet::Avx512.tile_vectors(),
            };
            check_rows::<Bf16, bf16>(unit.name(), unit, most_vectors);
        }
        say(unit.name(), unit.can_be_tested(), unit.is_there());
    }
    for unit in Int8Unit::ALL.iter().copied() {
        if unit.can_be_tested() {
            check_int8(unit);
        }
        say(unit.name(), unit.can_be_tested(), unit.is_there());
    }
}

/// In equal parts of at most a tile it has one part more than pixels for it.
#[cfg(all(target_arch = "x86_64", target_os = "linux"))]
#[test]
fn tiles_cover_a_long_row() {
    assert!(Bf16Unit::Amx.can_be_tested());
    check_row::<Bf16, bf16>("amx-bf16", Bf16Unit::Amx, (2, 1, 1), 1, (609, LANES));
}

fn say(name: &str, was_tested: bool, is_there: bool) {
    match (was_tested, is_there) {
        (true, true) => println!("tested: {name}"),
        (true, false) => println!("tested: {name}, emulated"),
        _ => println!("skipped: {name}, which this processor has not"),
    }
}

#[cfg(target_arch = "aarch64")]
#[test]
fn a_64_bit_arm_computes_with_neon() {
    assert_eq!(InstructionSet::detect(), InstructionSet::Neon);
}

fn check_outer_products(set: InstructionSet) {
    let (inputs, pixels, rows) = (23, 5, 3);
    for vectors in 1..=set.tile_vectors() {
        let width = vectors * LANES;
        let pitch = pixels * inputs + 4;
        let input = numbers(rows * pitch, 1);
        let gradient = numbers(rows * pixels * width, 2);
        let start = numbers(inputs * width, 3);
        let mut sums = start.clone();
        let outer = Outer {
            input: input.as_ptr(),
            input_step: inputs,
            input_pitch: pitch,
            run: inputs,
            gradient: gradient.as_ptr(),
            gradient_step: width,
            gradient_pitch: pixels * width,
            vectors,
            pixels,
            rows,
            sums: sums.as_mut_ptr(),
        };
        // SAFETY: all slices have the lengths that the fields promise, and `set` is there.
        unsafe { outer.run(set) };
        for (at, found) in sums.iter().enumerate() {
            let (k, c) = (at / width, at % width);
            let products = (0..rows * pixels).map(|i| {
                let (y, x) = (i / pixels, i % pixels);
                f64::from(input[y * pitch + x * inputs + k])
                    * f64::from(gradient[(y * pixels + x) * width + c])
            });
            let sum = Sum::of(std::iter::once(f64::from(start[at])).chain(products));
            let error = (sum.value - f64::from(*found)).abs();
            let what = format!("{set:?}, {vectors} vectors, at {at}");
            assert!(
                error <= sum.tolerance(),
                "{what}: {found}, not {}",
                sum.value
            );
        }
    }
}

#[test]
fn single_pixels_are_few() {
    for (pixels, most, expected) in [
        (32, 6, 4),
        (64, 6, 10),
        (30, 6, 5),
        (33, 6, 4),
        (3, 6, 0),
        (20, 16, 1),
        (0, 6, 0),
    ] {
        assert_eq!(whole_tiles(pixels, most), expected, "{pixels} by {most}");
    }
}
