//! Every unit that the machine has, against products in f64 and in whole numbers.

use std::io::Write as _;
use std::sync::Arc;

use proptest::prelude::*;

use super::*;
use crate::ops::simd::BytesUnit;

/// (rows, inputs, outputs) with rests of every kind: of groups, of vectors, of panels and of tiles.
const SHAPES: [(usize, usize, usize); 8] = [
    (1, 1, 1),
    (1, 5, 3),
    (7, 16, 64),
    (64, 33, 100),
    (19, 128, 48),
    (33, 70, 130),
    (5, 1027, 17),
    (0, 8, 16),
];

fn units() -> impl Iterator<Item = Int8Unit> {
    let all = Int8Unit::ALL.iter().copied();
    all.filter(|unit| unit.can_be_tested())
}

fn numbers(count: usize, seed: usize) -> Vec<f32> {
    (0..count)
        .map(|i| ((i * 7919 + seed * 104_729) % 2003) as f32 / 1001.0 - 1.0)
        .collect()
}

/// The product, with rows that lie apart: between them is what must not be read or written.
fn product(packed: &Int8Panels, x: &[f32]) -> Vec<f32> {
    let (inputs, outputs) = (packed.panels.depth, packed.panels.outputs);
    let count = x.len() / inputs;
    let (x_step, y_step) = (inputs + 3, outputs + 2);
    let mut apart = vec![f32::NAN; count * x_step];
    for (apart, x) in apart.chunks_exact_mut(x_step).zip(x.chunks_exact(inputs)) {
        apart[..inputs].copy_from_slice(x);
    }
    let mut y = vec![7.0; count * y_step];
    // What an earlier, larger product leaves must not matter.
    ROUNDED.with_borrow_mut(|buffers| {
        *buffers = Rounded {
            bytes: vec![-99; 100_000],
            #[cfg(target_arch = "x86_64")]
            words: vec![-99; 100_000],
            #[cfg(target_arch = "x86_64")]
            panel: vec![-99; 100_000],
            scales: vec![f32::NAN; 1000],
        };
    });
    let x = Rows {
        values: apart.as_slice(),
        step: x_step,
        count,
    };
    let target = Rows {
        values: y.as_mut_slice(),
        step: y_step,
        count,
    };
    packed.product_of_rows(x, target);
    let rows = y.chunks_exact(y_step).flat_map(|row| {
        assert_eq!(row[outputs..], [7.0; 2], "wrote too far");
        row[..outputs].to_vec()
    });
    rows.collect()
}

/// Largest absolute value.
fn most(values: impl Iterator<Item = f32>) -> f64 {
    values.fold(0.0, |most, v| most.max(f64::from(v).abs()))
}

#[test]
fn a_product_is_off_by_its_rounding_at_most() {
    for (rows, inputs, outputs) in SHAPES {
        let (x, w) = (numbers(rows * inputs, 1), numbers(outputs * inputs, 2));
        let bias = numbers(outputs, 3);
        let uneven: Vec<f32> = (0..inputs).map(|k| 0.25 + (k % 7) as f32).collect();
        for unit in units() {
            for factors in [vec![1.0; inputs], uneven.clone()] {
                let shape = (outputs, inputs);
                let packed = Int8Panels::pack(unit, &w, Some(&bias), shape, factors.clone());
                let y = product(&packed, &x);
                assert_eq!(y.len(), rows * outputs);
                for (at, y) in y.iter().enumerate() {
                    let (row, n) = (at / outputs, at % outputs);
                    let (x, w) = (&x[row * inputs..][..inputs], &w[n * inputs..][..inputs]);
                    let x = || x.iter().zip(&factors).map(|(x, f)| x * f);
                    let w = || w.iter().zip(&factors).map(|(w, f)| w / f);
                    // Each factor of a product is off by half of what 1 stands for, and by the rounding of f32.
                    let half = |most: f64| most / 127.0 / 2.0 * (1.0 + 1e-4);
                    let (of_x, of_w) = (half(most(x())), half(most(w())));
                    let (mut expected, mut bound) = (f64::from(bias[n]), 1e-5);
                    for (x, w) in x().zip(w()) {
                        let (x, w) = (f64::from(x), f64::from(w));
                        expected += x * w;
                        bound += x.abs() * of_w + w.abs() * of_x + of_x * of_w;
                    }
                    let error = (expected - f64::from(*y)).abs();
                    let what = format!("{unit:?} {rows} x {inputs} x {outputs}");
                    assert!(error <= bound, "{what}: {error}, at most {bound}");
                }
            }
        }
    }
}

/// Rows of whole numbers up to 127, of which one is that: they are rounded to themselves.
fn whole(rows: usize, width: usize, seed: usize) -> Vec<i8> {
    let mut values: Vec<i8> = (0..rows * width)
        .map(|i| ((i * 7919 + seed * 31) % 255) as i16 - 127)
        .map(|v| v as i8)
        .collect();
    for (r, row) in values.chunks_exact_mut(width).enumerate() {
        row[r * 5 % width] = if r % 2 == 0 { 127 } else { -127 };
    }
    values
}

fn check_exact(unit: Int8Unit, (x, w): (&[i8], &[i8]), inputs: usize) {
    let real = |values: &[i8]| values.iter().map(|v| f32::from(*v)).collect::<Vec<_>>();
    let outputs = w.len() / inputs;
    let ones = vec![1.0; inputs];
    let packed = Int8Panels::pack(unit, &real(w), None, (outputs, inputs), ones);
    let found = product(&packed, &real(x));
    let mut expected = Vec::new();
    for x in x.chunks_exact(inputs) {
        for w in w.chunks_exact(inputs) {
            let products = x.iter().zip(w).map(|(x, w)| i64::from(*x) * i64::from(*w));
            expected.push(products.sum::<i64>() as f32);
        }
    }
    assert_eq!(found, expected, "{unit:?} of {inputs} inputs");
}

/// Sums of whole numbers are exact.
pub(in crate::ops) fn check_unit(unit: Int8Unit) {
    for (rows, inputs, outputs) in SHAPES {
        let (x, w) = (whole(rows, inputs, 1), whole(outputs, inputs, 2));
        check_exact(unit, (&x, &w), inputs);
    }
}

#[test]
fn sums_of_whole_numbers_are_exact() {
    units().for_each(check_unit);
}

#[test]
fn nothing_saturates() {
    let outputs = 65;
    for inputs in [2, 4, 1024, 4099, MOST_INPUTS] {
        for unit in units() {
            for (x, w) in [(127, 127), (-127, 127), (127, -127), (-127, -127)] {
                let (x, w) = (vec![x; 5 * inputs], vec![w; outputs * inputs]);
                check_exact(unit, (&x, &w), inputs);
            }
        }
    }
}

proptest! {
    #[test]
    fn every_unit_gives_the_same_bits(
        (rows, inputs, outputs) in (1usize..12, 1usize..90, 1usize..70),
        seed in any::<u32>(),
        exponent in -20i32..20,
    ) {
        let seed = seed as usize;
        let scaled = |values: Vec<f32>| -> Vec<f32> {
            values.into_iter().map(|v| v * 2f32.powi(exponent)).collect()
        };
        let (x, w) = (scaled(numbers(rows * inputs, seed)), numbers(outputs * inputs, seed + 1));
        let bias = numbers(outputs, seed + 2);
        let factors: Vec<f32> = numbers(inputs, seed + 3).iter().map(|f| f.abs() + 0.1).collect();
        let bits = |unit| -> Vec<u32> {
            let packed = Int8Panels::pack(unit, &w, Some(&bias), (outputs, inputs), factors.clone());
            product(&packed, &x).iter().map(|y| y.to_bits()).collect()
        };
        let expected = bits(Int8Unit::Bytes(BytesUnit::Portable));
        for unit in units() {
            prop_assert_eq!(&bits(unit), &expected, "{:?}", unit);
        }
    }

    #[test]
    fn values_are_rounded_to_the_nearest(
        values in proptest::collection::vec(-1e3f32..1e3, 1..100),
        exponent in -100i32..100,
    ) {
        let values: Vec<f32> = values.iter().map(|v| v * 2f32.powi(exponent)).collect();
        let mut largest = 0;
        largest_bits(&values, None, &mut largest);
        let (scale, of_one) = scale_of(largest);
        prop_assert_eq!(f64::from(f32::from_bits(largest)), most(values.iter().copied()));
        let ones = vec![1.0; values.len()];
        let mut rounded = vec![0; values.len()];
        for offset in [0, 128] {
            round_row(&values, &ones, of_one, offset, &mut rounded);
            for (value, rounded) in values.iter().zip(&rounded) {
                let rounded = i32::from(rounded.wrapping_sub(offset as i8));
                prop_assert!(rounded != -128);
                let error = (f64::from(*value) - f64::from(rounded) * f64::from(scale)).abs();
                prop_assert!(error <= f64::from(scale) * 0.5001, "{} as {}", value, rounded);
            }
        }
    }
}

#[test]
fn a_row_that_is_not_finite_gives_no_numbers_and_the_others_do() {
    let (inputs, outputs) = (37, 33);
    let weight = numbers(inputs * outputs, 1);
    for unit in units() {
        let packed = Int8Panels::pack(unit, &weight, None, (outputs, inputs), vec![1.0; inputs]);
        let good = product(&packed, &numbers(3 * inputs, 2));
        assert!(good.iter().all(|y| y.is_finite()));
        for bad in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut x = numbers(3 * inputs, 2);
            x[inputs + 36] = bad;
            let y = product(&packed, &x);
            assert_eq!(y[..outputs], good[..outputs], "{unit:?}");
            assert!(y[outputs..2 * outputs].iter().all(|y| y.is_nan()));
            assert_eq!(y[2 * outputs..], good[2 * outputs..], "{unit:?}");
        }
    }
}

#[test]
fn an_output_whose_weights_are_not_finite_is_no_number() {
    let mut weight = numbers(2 * 8, 1);
    weight[9] = f32::INFINITY;
    for unit in units() {
        let packed = Int8Panels::pack(unit, &weight, None, (2, 8), vec![1.0; 8]);
        let y = product(&packed, &numbers(8, 2));
        assert!(y[0].is_finite() && y[1].is_nan(), "{unit:?}: {y:?}");
    }
}

#[test]
fn of_zeros_and_what_is_as_good_the_bias_is_left() {
    let (bias, weight) = ([0.5, -2.0, 3.0], numbers(3 * 6, 1));
    for unit in units() {
        let packed = Int8Panels::pack(unit, &weight, Some(&bias), (3, 6), vec![1.0; 6]);
        for x in [0.0, -0.0, 1e-40, f32::MIN_POSITIVE] {
            assert_eq!(product(&packed, &[x; 6]), bias, "{unit:?} of {x}");
        }
        let zeros = Int8Panels::pack(unit, &[0.0; 18], Some(&bias), (3, 6), vec![1.0; 6]);
        assert_eq!(product(&zeros, &numbers(6, 2)), bias, "{unit:?}");
    }
}

#[test]
fn what_was_packed_is_mapped() {
    let (outputs, inputs) = (100, 33);
    let weight = numbers(outputs * inputs, 1);
    let bias = numbers(outputs, 2);
    let factors: Vec<f32> = (0..inputs).map(|k| 0.5 + k as f32).collect();
    let unit = Int8Unit::detect();
    let packed = Int8Panels::pack(unit, &weight, Some(&bias), (outputs, inputs), factors);
    let mut file = tempfile::tempfile().unwrap();
    for part in packed.parts() {
        file.write_all(part).unwrap();
    }
    // SAFETY: nobody else has the file.
    let map = Arc::new(unsafe { memmap2::Mmap::map(&file) }.unwrap());
    let bytes = MappedBytes::new(&map, 0..map.len()).unwrap();
    let mapped = Int8Panels::mapped(&bytes, Some(&bias), (outputs, inputs)).unwrap();
    let x = numbers(4 * inputs, 3);
    assert_eq!(product(&mapped, &x), product(&packed, &x));
    for shape in [
        (100, 32),
        (120, 33),
        (0, 0),
        (100, usize::MAX),
        (usize::MAX, 1),
    ] {
        assert!(
            Int8Panels::mapped(&bytes, None, shape).is_none(),
            "{shape:?}"
        );
    }
}
