#![allow(clippy::unwrap_used)]

use super::*;

/// Pseudorandom integers.
fn noise(index: usize) -> f64 {
    ((index * 7919 + index * index * 104_729) % 1009) as f64 / 1009.0 - 0.5
}

fn table(rows: usize, columns: usize, of: impl Fn(usize, usize) -> f64) -> Table {
    let values = (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
    let values = values.map(|(row, column)| of(row, column)).collect();
    Table::new(values, columns).unwrap()
}

#[test]
fn single_columns_give_pearson() {
    let x = table(20, 1, |row, _| noise(row));
    let y = table(20, 1, |row, _| noise(row) - 2.0 * noise(row + 100));
    let expected = pearson(&x.column(0), &y.column(0)).unwrap().r;
    let found = CanonicalCorrelation::fit(&x, &y, Regularisation::None).unwrap();
    assert!((found.correlations()[0] - expected.abs()).abs() < 1e-12);
    assert!((found.eta() - expected.abs()).abs() < 1e-12);
}

#[test]
fn linear_actions_are_found() {
    let x = table(50, 4, |row, column| noise(row * 4 + column));
    let y = table(50, 2, |row, column| {
        3.0 * noise(row * 4 + column) - noise(row * 4 + 3) + 7.0
    });
    let found = CanonicalCorrelation::fit(&x, &y, Regularisation::None).unwrap();
    assert!(
        found
            .correlations()
            .iter()
            .all(|rho| (rho - 1.0).abs() < 1e-9)
    );
    let (of_x, of_y) = (
        found.project_features(&x, 2).unwrap(),
        found.project_actions(&y, 2).unwrap(),
    );
    let pairs = of_x.iter().flatten().zip(of_y.iter().flatten());
    assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-9));
    let own: f64 = of_x.column(0).iter().map(|value| value * value).sum();
    assert!((own / 49.0 - 1.0).abs() < 1e-9);
    let across: f64 = of_x
        .column(0)
        .iter()
        .zip(of_x.column(1))
        .map(|(a, b)| a * b)
        .sum();
    assert!(across.abs() < 1e-9);
}

#[test]
fn more_features_than_samples_need_regularisation() {
    let x = table(20, 40, |row, column| noise(row * 40 + column));
    let y = table(20, 2, |row, column| {
        noise(row * 40 + column) + noise(5000 + row * 2 + column)
    });
    let none = CanonicalCorrelation::fit(&x, &y, Regularisation::None);
    assert!(matches!(
        none,
        Err(MetricError::Singular {
            rows: 20,
            columns: 40,
            ..
        })
    ));
    let ridged = CanonicalCorrelation::fit(&x, &y, Regularisation::Ridge(1.0)).unwrap();
    let reduced = CanonicalCorrelation::fit(&x, &y, Regularisation::Components(5)).unwrap();
    for found in [&ridged, &reduced] {
        assert!(found.eta() > 0.1 && found.eta() <= 1.0, "{}", found.eta());
    }
    // As many components as samples: no regularisation.
    let all = CanonicalCorrelation::fit(&x, &y, Regularisation::Components(100)).unwrap();
    assert!((all.eta() - 1.0).abs() < 1e-6);
    let held_out = table(20, 40, |row, column| noise(9000 + row * 40 + column));
    assert!(all.correlations_of(&held_out, &y).unwrap()[0].abs() < 0.9);
}

#[test]
fn keeping_all_components_changes_nothing() {
    let x = table(30, 4, |row, column| {
        noise(row * 4 + column) * (column + 1) as f64
    });
    let y = table(30, 3, |row, column| {
        noise(row * 4 + column) + noise(700 + row * 3 + column)
    });
    let plain = CanonicalCorrelation::fit(&x, &y, Regularisation::None).unwrap();
    let turned = CanonicalCorrelation::fit(&x, &y, Regularisation::Components(4)).unwrap();
    for (a, b) in plain.correlations().iter().zip(turned.correlations()) {
        assert!((a - b).abs() < 1e-9);
    }
}

#[test]
fn undefined_correlations_are_named() {
    let x = table(10, 2, |row, column| noise(row * 2 + column));
    let still = table(
        10,
        2,
        |row, column| if column == 0 { noise(row) } else { 1.0 },
    );
    let fit = |x: &Table, y: &Table, r| CanonicalCorrelation::fit(x, y, r).map(|_| ());
    let constant = fit(&x, &still, Regularisation::None);
    assert_eq!(constant, Err(MetricError::Constant { what: "actions" }));
    assert!(matches!(
        fit(&still, &x, Regularisation::None),
        Err(MetricError::Singular { .. })
    ));
    let half = CanonicalCorrelation::fit(&still, &x, Regularisation::Ridge(0.1)).unwrap();
    assert_eq!(
        (half.correlations().len(), half.correlations()[1]),
        (2, 0.0)
    );
    assert_eq!(half.project_features(&still, 2).unwrap().columns(), 1);
    assert!(matches!(
        fit(&x, &x, Regularisation::Ridge(0.0)),
        Err(MetricError::Range { .. })
    ));
    assert!(matches!(
        fit(&x, &x, Regularisation::Components(0)),
        Err(MetricError::Range { .. })
    ));
    let short = table(2, 2, |row, column| noise(row + column));
    assert!(matches!(
        fit(&short, &short, Regularisation::None),
        Err(MetricError::TooFew { .. })
    ));
}
