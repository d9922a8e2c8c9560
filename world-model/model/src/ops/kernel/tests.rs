//! Every instruction set that the machine has, against plain loops.

use super::*;
use crate::ops::product::F32;

fn sets() -> Vec<InstructionSet> {
    let mut sets = vec![InstructionSet::Portable];
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            sets.push(InstructionSet::Avx2);
        }
        if is_x86_feature_detected!("avx512f") {
            sets.push(InstructionSet::Avx512);
        }
    }
    sets
}

fn numbers(count: usize, seed: usize) -> Vec<f32> {
    (0..count)
        .map(|i| ((i * 7919 + seed * 104_729) % 2003) as f32 / 1001.0 - 1.0)
        .collect()
}

fn assert_close(what: &str, found: &[f32], expected: &[f32]) {
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() < 1e-4, "{what} at {i}: {a}, expected {b}");
    }
}

#[test]
fn a_row_of_pixels_is_summed_and_finished() {
    let (inputs, tap_rows, tap_columns) = (5, 3, 3);
    let run = inputs * tap_columns;
    for set in sets() {
        for vectors in 1..=set.tile_vectors() {
            // Less than a tile, whole tiles, and tiles that overlap; whole and partial vectors.
            for (pixels, channels) in [
                (1, vectors * LANES),
                (16, vectors * LANES - 3),
                (19, vectors * LANES),
            ] {
                let pitch = (pixels + tap_columns - 1) * inputs;
                let input = numbers(tap_rows * pitch, 1);
                let panel = numbers(tap_rows * run * vectors * LANES, 2);
                let bias = numbers(vectors * LANES, 3);
                let residual = numbers(pixels * channels, 4);
                let mask = numbers(pixels * channels, 5);
                let mut output = vec![9.0; pixels * channels + 1];
                let row = Row::<F32> {
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
                    residual: residual.as_ptr(),
                    mask: mask.as_ptr(),
                    output_step: channels,
                    channels,
                    relu: true,
                };
                // SAFETY: all slices have the lengths that the fields promise, and `set` is there.
                unsafe { row.run(set) };
                let mut expected = Vec::new();
                for x in 0..pixels {
                    for c in 0..channels {
                        let at = x * channels + c;
                        let mut sum = bias[c] + residual[at];
                        for t in 0..tap_rows {
                            for r in 0..run {
                                sum += input[t * pitch + x * inputs + r]
                                    * panel[(t * run + r) * vectors * LANES + c];
                            }
                        }
                        expected.push(if mask[at] > 0.0 { sum.max(0.0) } else { 0.0 });
                    }
                }
                let what = format!("{set:?} {vectors} vectors {pixels} pixels");
                assert_close(&what, &output, &expected);
                assert_eq!(output[pixels * channels], 9.0, "{what}: wrote too far");
            }
        }
    }
}

#[test]
fn outer_products_are_added() {
    let (inputs, pixels, rows) = (23, 5, 3);
    for set in sets() {
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
            let mut expected = start;
            for (k, row) in expected.chunks_exact_mut(width).enumerate() {
                for (c, sum) in row.iter_mut().enumerate() {
                    for y in 0..rows {
                        for x in 0..pixels {
                            *sum += input[y * pitch + x * inputs + k]
                                * gradient[(y * pixels + x) * width + c];
                        }
                    }
                }
            }
            assert_close(&format!("{set:?} {vectors} vectors"), &sums, &expected);
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
