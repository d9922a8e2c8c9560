//! Parity with the field's libraries (../fixtures/generate.py, versions beside it). Unless noted, the tolerance is
//! 1e-9, relative above 1.

use image::RgbImage;
use serde_json::Value;
use wm_metrics::{
    Table,
    classification::{Confusion, cohen_kappa, roc_auc},
    correlation::{CanonicalCorrelation, Correlation, Regularisation, pearson, spearman},
    depth::{abs_rel_median_scaled, abs_rel_scaled_and_shifted},
    distributions::{
        Estimator, Moments, PolynomialKernel, frechet_distance, maximum_mean_discrepancy,
    },
    images::{psnr, ssim, ssim_luminance},
    motion::{Flow, feature_consistency, warp},
    ranking::{Ties, ranks},
    statistics::{
        Bootstrap, Method, SignFlip, bootstrap_mean, sign_flip_test, standard_error, wilson,
    },
};

fn golden(section: &str) -> Value {
    let all: Value = serde_json::from_str(include_str!("../fixtures/golden.json")).unwrap();
    all[section].clone()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn count(value: &Value) -> usize {
    usize::try_from(value.as_u64().unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(number).collect()
}

#[track_caller]
fn assert_close(found: f64, expected: f64, tolerance: f64) {
    let size = expected.abs().max(1.0);
    assert!(
        (found - expected).abs() <= tolerance * size,
        "{found} against {expected}"
    );
}

/// `noise` of the generator.
fn noise(index: usize) -> f64 {
    ((index * 7919 + index * index * 104_729) % 1009) as f64 / 1009.0 - 0.5
}

/// `table` of the generator.
fn table(rows: usize, columns: usize, start: usize) -> Table {
    Table::new(
        (start..start + rows * columns).map(noise).collect(),
        columns,
    )
    .unwrap()
}

/// `features` of the generator.
fn features(rows: usize, columns: usize, start: usize, shift: f64) -> Table {
    let plain = table(rows, columns, start);
    Table::from_rows(plain.iter().map(|row| {
        let before = |column: usize| row[(column + columns - 1) % columns];
        let mixed = (0..columns).map(|column| row[column] + 0.5 * before(column) + shift);
        mixed.collect::<Vec<f64>>()
    }))
    .unwrap()
}

#[test]
fn images_match_scikit_image() {
    for case in golden("images").as_array().unwrap() {
        let [width, height] = [0, 1].map(|side| count(&case["size"][side]) as u32);
        let picture = |s: u32| {
            RgbImage::from_fn(width, height, |x, y| {
                image::Rgb([0, 1, 2].map(|c| {
                    let value = if case["kind"] == "pattern" {
                        x * 37 + y * 59 + c * 101 + x * y * s
                    } else {
                        x * 5 + y * 3 + c * 20 + (x * y * s) % 17
                    };
                    (value % 256) as u8
                }))
            })
        };
        let (a, b) = (picture(3), picture(4));
        assert_close(psnr(&a, &b).unwrap(), number(&case["psnr"]), 1e-9);
        assert_close(ssim(&a, &b).unwrap(), number(&case["ssim"]), 1e-9);
        let luminance = number(&case["ssim_luminance"]);
        assert_close(ssim_luminance(&a, &b).unwrap(), luminance, 1e-9);
    }
}

#[test]
fn frechet_distance_matches_torchmetrics() {
    // At 0, torchmetrics' eigenvalues of an asymmetric matrix lose half of the digits.
    for case in golden("distributions").as_array().unwrap() {
        let (rows, columns) = (&case["rows"], count(&case["columns"]));
        let a = Moments::of(&features(count(&rows[0]), columns, 0, 0.0)).unwrap();
        let b = Moments::of(&features(count(&rows[1]), columns, 5000, 0.1)).unwrap();
        let has_full_rank = count(&rows[0]) > columns;
        let tolerance = if has_full_rank { 1e-9 } else { 1e-6 };
        let expected = number(&case["fid"]);
        assert_close(frechet_distance(&a, &b).unwrap(), expected, tolerance);
        assert_close(frechet_distance(&b, &a).unwrap(), expected, tolerance);
    }
}

#[test]
fn discrepancies_match_torchmetrics_and_jedi() {
    for case in golden("distributions").as_array().unwrap() {
        let (rows, columns) = (&case["rows"], count(&case["columns"]));
        let of = |rows: [usize; 2], kernel, estimator| {
            let a = features(rows[0], columns, 0, 0.0);
            let b = features(rows[1], columns, 5000, 0.1);
            maximum_mean_discrepancy(&a, &b, kernel, estimator).unwrap()
        };
        let all = [0, 1].map(|side| count(&rows[side]));
        let jedi = of(all, PolynomialKernel::JEDI, Estimator::Biased);
        assert_close(jedi, number(&case["jedi"]), 1e-9);
        let same = [count(&case["kid_rows"]); 2];
        let kid = of(same, PolynomialKernel::KID, Estimator::Unbiased);
        assert_close(kid, number(&case["kid"]), 1e-9);
    }
}

#[test]
fn correlations_match_scipy() {
    for case in golden("correlations").as_array().unwrap() {
        let (x, y) = (numbers(&case["x"]), numbers(&case["y"]));
        let check = |found: Correlation, name: &str| {
            assert_close(found.r, number(&case[name]), 1e-9);
            let interval = found.interval.unwrap();
            let expected = numbers(&case[format!("{name}_interval")]);
            assert_close(interval.low, expected[0], 1e-9);
            assert_close(interval.high, expected[1], 1e-9);
        };
        check(pearson(&x, &y).unwrap(), "pearson");
        check(spearman(&x, &y).unwrap(), "spearman");
    }
}

#[test]
fn canonical_correlations_match_svd_and_scikit_learn() {
    for case in golden("canonical").as_array().unwrap() {
        let [rows, p, q] = ["rows", "p", "q"].map(|name| count(&case[name]));
        let x = features(rows, p, 100, 0.0);
        let noise = table(rows, q, 20000);
        let y = x.iter().zip(&noise).map(|(x, noise)| {
            let mixed = x.iter().zip(noise).map(|(x, noise)| x * 0.7 + noise);
            mixed.collect::<Vec<f64>>()
        });
        let y = Table::from_rows(y).unwrap();
        let found = CanonicalCorrelation::fit(&x, &y, Regularisation::None).unwrap();
        let (rho, sklearn) = (numbers(&case["rho"]), numbers(&case["sklearn"]));
        assert_eq!(found.correlations().len(), q);
        for (index, found) in found.correlations().iter().enumerate() {
            assert_close(*found, rho[index], 1e-9);
            // scikit-learn approaches it by iteration.
            assert_close(*found, sklearn[index], 1e-5);
        }
        let squares: f64 = rho.iter().map(|rho| rho * rho).sum();
        assert_close(found.eta(), (squares / q as f64).sqrt(), 1e-9);
    }
}

#[test]
fn classification_matches_scikit_learn() {
    let case = golden("classification");
    let scores = numbers(&case["scores"]);
    let truth = case["truth"].as_array().unwrap();
    let truth: Vec<bool> = truth.iter().map(|truth| truth.as_bool().unwrap()).collect();
    let verdicts: Vec<bool> = scores.iter().map(|score| *score > 0.0).collect();
    let counts = Confusion::of(&verdicts, &truth).unwrap();
    let expected = [0, 1, 2, 3].map(|index| count(&case["confusion"][index]));
    assert_eq!(
        [
            counts.true_positives,
            counts.false_negatives,
            counts.true_negatives,
            counts.false_positives
        ],
        expected
    );
    let balanced = counts.balanced_accuracy().unwrap();
    assert_close(balanced, number(&case["balanced_accuracy"]), 1e-12);
    let auc = roc_auc(&scores, &truth).unwrap();
    assert_close(auc, number(&case["auc"]), 1e-12);
    let labels = |name: &str| -> Vec<usize> {
        let labels = case[name].as_array().unwrap().iter();
        labels.map(count).collect()
    };
    let kappa = cohen_kappa(&labels("a"), &labels("b")).unwrap();
    assert_close(kappa, number(&case["kappa"]), 1e-12);
}

#[test]
fn ranks_match_scipy() {
    let case = golden("ranks");
    let values = numbers(&case["values"]);
    for ties in [
        Ties::Best,
        Ties::Mean,
        Ties::Worst,
        Ties::Dense,
        Ties::InOrder,
    ] {
        let expected = numbers(&case["ranks"][format!("{ties:?}")]);
        assert_eq!(ranks(&values, ties).unwrap(), expected);
    }
}

#[test]
fn statistics_match_scipy() {
    let case = golden("statistics");
    let values = numbers(&case["values"]);
    assert_close(
        standard_error(&values).unwrap(),
        number(&case["standard_error"]),
        1e-12,
    );
    // Different random numbers: the ends of 10 000 resamples scatter by 0.02 standard errors; the tolerance is five
    // times that.
    let found = bootstrap_mean(&values, &Bootstrap::default()).unwrap();
    let expected = number(&case["bootstrap_standard_error"]);
    let tolerance = 0.1 * expected;
    let ends = numbers(&case["bootstrap"]);
    assert!(
        (found.interval.low - ends[0]).abs() < tolerance,
        "{found:?}"
    );
    assert!(
        (found.interval.high - ends[1]).abs() < tolerance,
        "{found:?}"
    );
    assert!(
        (found.standard_error / expected - 1.0).abs() < 0.03,
        "{found:?}"
    );
    for case in case["wilson"].as_array().unwrap() {
        let found = wilson(count(&case[0]), count(&case[1])).unwrap();
        assert_close(found.low, number(&case[2]), 1e-12);
        assert_close(found.high, number(&case[3]), 1e-12);
    }
}

#[test]
fn sign_flips_match_scipy() {
    let mut methods = Vec::new();
    for case in golden("statistics")["sign_flips"].as_array().unwrap() {
        let differences = numbers(&case["differences"]);
        let found = sign_flip_test(&differences, &SignFlip::default()).unwrap();
        assert_close(found.p, number(&case["p"]), 1e-12);
        methods.push(found.method);
    }
    assert_eq!(methods[0], Method::Convolved);
}

#[test]
fn motion_and_depth_match_pytorch() {
    let case = golden("motion");
    let [width, height] = [0, 1].map(|side| count(&case["size"][side]));
    let single = |values: &[f64]| values.iter().map(|value| *value as f32).collect::<Vec<_>>();
    let picture: Vec<f32> = (0..width * height * 3).map(|i| noise(i) as f32).collect();
    let vectors = table(width * height, 2, 4000);
    let plane = |column| -> Vec<f32> {
        let values = vectors.column(column);
        values.iter().map(|value| (8.0 * value) as f32).collect()
    };
    let (width, height) = (width as u32, height as u32);
    let picture = image::Rgb32FImage::from_raw(width, height, picture).unwrap();
    let flow = Flow::new(width, height, plane(0), plane(1)).unwrap();
    let warped = warp(&picture, &flow).unwrap();
    for (found, expected) in warped.as_raw().iter().zip(numbers(&case["warped"])) {
        // Seven digits in the file, f32 here.
        assert_close(f64::from(*found), expected, 1e-6);
    }
    let frames = Table::from_rows(
        table(6, 10, 0)
            .iter()
            .map(|row| row.iter().map(|value| value + 0.3).collect::<Vec<_>>()),
    );
    let found = feature_consistency(&frames.unwrap()).unwrap();
    assert_close(found, number(&case["consistency"]), 1e-9);
    let (depth, truth) = (
        single(&numbers(&case["depth"])),
        single(&numbers(&case["truth"])),
    );
    let scaled = abs_rel_median_scaled(&depth, &truth).unwrap();
    assert_close(scaled, number(&case["abs_rel_median"]), 1e-9);
    let fitted = abs_rel_scaled_and_shifted(&depth, &truth).unwrap();
    assert_close(fitted, number(&case["abs_rel_fitted"]), 1e-9);
}
