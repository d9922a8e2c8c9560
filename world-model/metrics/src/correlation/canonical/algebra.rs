use nalgebra::{Cholesky, DMatrix, Dyn, SymmetricEigen};

use crate::MetricError;

/// Pivots of Cholesky's factor below this share of the largest mean dependent columns: columns have variance 1,
/// rounding errors are 1e-16.
const DEPENDENT: f64 = 1e-12;

/// Leading principal axes (p, k), scaled to projections of variance 1, from the smaller of the two matrices with the
/// same eigenvalues.
pub(super) fn components(values: &DMatrix<f64>, most: usize) -> Result<DMatrix<f64>, MetricError> {
    if most == 0 {
        return Err(MetricError::Range {
            what: "the number of components",
            expected: "at least 1",
            actual: most.to_string(),
        });
    }
    let is_tall = values.nrows() > values.ncols();
    let square = if is_tall {
        values.tr_mul(values)
    } else {
        values * values.transpose()
    };
    let eigen = SymmetricEigen::new(square);
    let kept = leading(&eigen, eigen.eigenvalues.amax() * DEPENDENT, most);
    let mut axes = select(&eigen, &kept);
    if !is_tall {
        axes = values.tr_mul(&axes);
    }
    let scores = values * &axes;
    for (mut axis, scores) in axes.column_iter_mut().zip(scores.column_iter()) {
        axis *= freedom(values).sqrt() / scores.norm();
    }
    Ok(axes)
}

/// Indices of the greatest eigenvalues above a floor, greatest first.
pub(super) fn leading(eigen: &SymmetricEigen<f64, Dyn>, floor: f64, most: usize) -> Vec<usize> {
    let values = eigen.eigenvalues.iter().copied().enumerate();
    let mut order: Vec<(usize, f64)> = values.filter(|(_, value)| *value > floor).collect();
    order.sort_by(|a, b| b.1.total_cmp(&a.1));
    order.truncate(most);
    order.into_iter().map(|(index, _)| index).collect()
}

pub(super) fn select(eigen: &SymmetricEigen<f64, Dyn>, kept: &[usize]) -> DMatrix<f64> {
    eigen.eigenvectors.select_columns(kept)
}

/// Cholesky's factor of the ridged covariance.
pub(super) fn root(
    what: &'static str,
    values: &DMatrix<f64>,
    ridge: f64,
) -> Result<DMatrix<f64>, MetricError> {
    let mut covariance = values.tr_mul(values) / freedom(values);
    for index in 0..covariance.nrows() {
        if let Some(variance) = covariance.get_mut((index, index)) {
            *variance += ridge;
        }
    }
    let factor = Cholesky::<f64, Dyn>::new(covariance).ok_or_else(|| singular(what, values))?;
    let factor = factor.unpack();
    let pivots = factor.diagonal();
    if pivots.min() < pivots.max() * DEPENDENT.sqrt() {
        return Err(singular(what, values));
    }
    Ok(factor)
}

pub(super) fn solve(
    what: &'static str,
    factor: &DMatrix<f64>,
    right: &DMatrix<f64>,
    values: &DMatrix<f64>,
) -> Result<DMatrix<f64>, MetricError> {
    let solved = factor.solve_lower_triangular(right);
    solved.ok_or_else(|| singular(what, values))
}

pub(super) fn solve_transposed(
    what: &'static str,
    factor: &DMatrix<f64>,
    right: &DMatrix<f64>,
    values: &DMatrix<f64>,
) -> Result<DMatrix<f64>, MetricError> {
    let solved = factor.tr_solve_lower_triangular(right);
    solved.ok_or_else(|| singular(what, values))
}

pub(super) fn freedom(values: &DMatrix<f64>) -> f64 {
    values.nrows() as f64 - 1.0
}

fn singular(what: &'static str, values: &DMatrix<f64>) -> MetricError {
    MetricError::Singular {
        what,
        rows: values.nrows(),
        columns: values.ncols(),
    }
}
