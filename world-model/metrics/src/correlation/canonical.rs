//! Canonical correlations of two tables.

mod algebra;
mod side;

use nalgebra::{DMatrix, SymmetricEigen};

use super::pearson;
use crate::{
    MetricError, Table,
    error::{same_length, varying},
};
use algebra::{components, freedom, leading, root, select, solve, solve_transposed};
use side::{Side, Standard};

/// Canonical correlations up to this are rounding errors of their squares.
const UNCORRELATED: f64 = 1e-7;

/// How to keep the features from fitting noise if there are nearly as many features as samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Regularisation {
    /// None: needs more samples than features, and linearly independent features.
    None,
    /// Adds this, above 0, to the variance of each feature, which is 1.
    Ridge(f64),
    /// Keeps at most this many leading principal components of the features, without those of zero variance.
    Components(usize),
}

/// Canonical correlation analysis of features with actions: the direction in features and the direction in actions with
/// the most correlated projections, then the next pairs, uncorrelated with the earlier ones.
///
/// The paper (figure "Action trajectories induced by encoder spaces") projects episodes onto the first two directions
/// "between IDM features and ground-truth actions" and prints rho_1, rho_2 and eta, which "summarizes the aggregate
/// action alignment" without a definition. [`Self::eta`] is Hooper's trace correlation, the usual figure of that kind.
///
/// Columns are scaled to variance 1. Without regularisation that does not change the correlations, which equal those of
/// scikit-learn's `CCA`. On the fitted samples, correlations tend to 1 with the number of features: hold samples out
/// for [`Self::correlations_of`].
#[derive(Clone, Debug)]
pub struct CanonicalCorrelation {
    features: Side,
    actions: Side,
    /// min(p, q); there are weights only for directions with a correlation.
    directions: usize,
    correlations: Vec<f64>,
}

impl CanonicalCorrelation {
    /// Fits features (n, p) and actions (n, q), rows of the same samples; min(p, q) directions. Constant features need
    /// regularisation; constant actions are rejected.
    ///
    /// # Errors
    /// [`MetricError::Length`] if the numbers of rows differ; [`MetricError::TooFew`] unless there are more rows than
    /// actions; [`MetricError::Constant`] if an action, or every feature, is constant; [`MetricError::Singular`] for
    /// linearly dependent columns; [`MetricError::Range`] for the regularisation.
    /// depend on others; [`MetricError::Range`] of the regularisation.
    pub fn fit(
        features: &Table,
        actions: &Table,
        regularisation: Regularisation,
    ) -> Result<Self, MetricError> {
        same_length(features.rows(), actions.rows())?;
        actions.require_rows("rows", (actions.columns() + 1).max(3))?;
        (0..actions.columns())
            .try_for_each(|column| varying("actions", &actions.column(column)))?;
        let (x, y) = (Standard::of(features), Standard::of(actions));
        if x.scales.amax() == 0.0 {
            return Err(MetricError::Constant { what: "features" });
        }
        let loadings = match regularisation {
            Regularisation::Components(most) => Some(components(&x.values, most)?),
            _ => None,
        };
        let reduced = loadings.as_ref().map(|loadings| &x.values * loadings);
        let reduced = reduced.as_ref().unwrap_or(&x.values);
        let ridge = match regularisation {
            Regularisation::Ridge(ridge) if !(ridge > 0.0 && ridge.is_finite()) => {
                return Err(MetricError::Range {
                    what: "a ridge",
                    expected: "above 0",
                    actual: ridge.to_string(),
                });
            }
            Regularisation::Ridge(ridge) => ridge,
            _ => 0.0,
        };
        let own = root("features", reduced, ridge)?;
        let others = root("actions", &y.values, 0.0)?;
        let between = reduced.tr_mul(&y.values) / freedom(reduced);
        let whitened = solve("features", &own, &between, reduced)?;
        let whitened = solve("actions", &others, &whitened.transpose(), &y.values)?.transpose();
        // nalgebra's SVD fails on matrices with a row of zeros.
        let decomposition = SymmetricEigen::new(whitened.tr_mul(&whitened));
        let kept = leading(&decomposition, UNCORRELATED * UNCORRELATED, usize::MAX);
        let right = select(&decomposition, &kept);
        let mut left = whitened * &right;
        for mut column in left.column_iter_mut() {
            column.normalize_mut();
        }
        let mut of_features = solve_transposed("features", &own, &left, reduced)?;
        let mut of_actions = solve_transposed("actions", &others, &right, &y.values)?;
        if let Some(loadings) = &loadings {
            of_features = loadings * of_features;
        }
        orient(&mut of_features, &mut of_actions);
        let mut fitted = Self {
            features: x.side(of_features),
            actions: y.side(of_actions),
            directions: features.columns().min(actions.columns()),
            correlations: Vec::new(),
        };
        fitted.correlations = fitted.correlations_of(features, actions)?;
        Ok(fitted)
    }

    /// rho_1, rho_2, ..: the min(p, q) correlations of the projections of the fitted samples; 0 for directions beyond
    /// the rank. With a ridge, these are still Pearson's r of the projections, not the shrunken roots of the ridged
    /// problem.
    #[must_use]
    pub fn correlations(&self) -> &[f64] {
        &self.correlations
    }

    /// Hooper's trace correlation (1959) of the fitted samples: the root of the mean squared canonical correlation, in
    /// \[0, 1\]. Without regularisation its square is the share of the whitened actions' variance that is linear in the
    /// features.
    #[must_use]
    pub fn eta(&self) -> f64 {
        trace_correlation(&self.correlations)
    }

    /// Correlations of the projections of other samples, for example held-out episodes; [`trace_correlation`] gives
    /// their eta.
    ///
    /// # Errors
    /// [`MetricError::Length`] if rows or columns differ in number; those of [`pearson`].
    /// [`MetricError::Length`] where rows or columns differ in number; those of [`pearson`].
    pub fn correlations_of(
        &self,
        features: &Table,
        actions: &Table,
    ) -> Result<Vec<f64>, MetricError> {
        let count = self.features.weights.ncols();
        let mut correlations = vec![0.0; self.directions];
        if count == 0 {
            return Ok(correlations);
        }
        let (x, y) = (
            self.project_features(features, count)?,
            self.project_actions(actions, count)?,
        );
        for (direction, correlation) in correlations.iter_mut().take(count).enumerate() {
            *correlation = pearson(&x.column(direction), &y.column(direction))?.r;
        }
        Ok(correlations)
    }

    /// Projections (n, `directions`) of features onto the leading directions: mean 0 and, without a ridge, variance 1
    /// in the fitted samples; fewer columns if fewer directions correlate. The paper draws two.
    ///
    /// # Errors
    /// [`MetricError::Length`] if the columns differ in number from the fitted ones; [`MetricError::Empty`] without any
    /// direction.
    pub fn project_features(
        &self,
        features: &Table,
        directions: usize,
    ) -> Result<Table, MetricError> {
        self.features.project(features, directions)
    }

    /// Projections of actions, as [`Self::project_features`]. A direction's greatest action weight is positive, so that
    /// pictures of two encoders are not mirrored.
    ///
    /// # Errors
    /// Those of [`Self::project_features`].
    pub fn project_actions(
        &self,
        actions: &Table,
        directions: usize,
    ) -> Result<Table, MetricError> {
        self.actions.project(actions, directions)
    }
}

/// The root of the mean squared canonical correlation; 0 if empty.
#[must_use]
pub fn trace_correlation(correlations: &[f64]) -> f64 {
    let squares: f64 = correlations.iter().map(|rho| rho * rho).sum();
    (squares / correlations.len().max(1) as f64).sqrt()
}

/// Flips pairs of directions so that the greatest action weight is positive.
fn orient(features: &mut DMatrix<f64>, actions: &mut DMatrix<f64>) {
    for (mut own, mut other) in features.column_iter_mut().zip(actions.column_iter_mut()) {
        let greatest = other.iter().fold(0.0_f64, |greatest, weight| {
            if weight.abs() > greatest.abs() {
                *weight
            } else {
                greatest
            }
        });
        if greatest < 0.0 {
            own.neg_mut();
            other.neg_mut();
        }
    }
}

#[cfg(test)]
mod tests;
