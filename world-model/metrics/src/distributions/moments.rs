use nalgebra::{DMatrix, DVector};

use crate::{MetricError, Table, error::finite};

/// Count, mean and covariance of feature vectors: all that a Fréchet distance needs, in constant memory.
///
/// For many vectors, compute [`Moments::of`] by block and [`Moments::merge`] them. The order of merging affects only
/// rounding.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    count: usize,
    mean: DVector<f64>,
    /// Sum of the outer products of the differences to the mean.
    scatter: DMatrix<f64>,
}

impl Moments {
    /// Moments of the rows of a table.
    ///
    /// # Errors
    /// [`MetricError::NotFinite`] if squares of the features exceed the range of f64.
    pub fn of(rows: &Table) -> Result<Self, MetricError> {
        let mut matrix = rows.matrix();
        let mean = matrix.row_mean().transpose();
        for (mut column, mean) in matrix.column_iter_mut().zip(mean.iter()) {
            column.add_scalar_mut(-mean);
        }
        let scatter = matrix.tr_mul(&matrix);
        finite("squares of the features", scatter.iter().copied())?;
        Ok(Self {
            count: rows.rows(),
            mean,
            scatter,
        })
    }

    /// Moments of both sets together (Chan et al. 1983).
    ///
    /// # Errors
    /// [`MetricError::Length`] if their vectors differ in length.
    pub fn merge(&self, other: &Self) -> Result<Self, MetricError> {
        self.same_dimensions(other)?;
        let (own, others) = (self.count as f64, other.count as f64);
        let (shift, share) = (&other.mean - &self.mean, others / (own + others));
        let mut scatter = &self.scatter + &other.scatter;
        scatter.ger(own * share, &shift, &shift, 1.0);
        Ok(Self {
            count: self.count + other.count,
            mean: &self.mean + shift * share,
            scatter,
        })
    }

    /// Number of vectors.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Number of features of a vector.
    #[must_use]
    pub fn dimensions(&self) -> usize {
        self.mean.len()
    }

    /// Mean of each feature.
    #[must_use]
    pub fn mean(&self) -> &[f64] {
        self.mean.as_slice()
    }

    /// Unbiased covariance of two features; `None` for a single vector or an unknown feature.
    #[must_use]
    pub fn covariance(&self, first: usize, second: usize) -> Option<f64> {
        let scatter = self.scatter.get((first, second))?;
        (self.count > 1).then(|| scatter / (self.count as f64 - 1.0))
    }

    pub(super) fn covariances(&self) -> Result<DMatrix<f64>, MetricError> {
        crate::error::at_least("feature vectors", 2, self.count)?;
        Ok(&self.scatter / (self.count as f64 - 1.0))
    }

    pub(super) fn same_dimensions(&self, other: &Self) -> Result<(), MetricError> {
        crate::error::same_length(self.dimensions(), other.dimensions())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn moments_of_three_points() {
        let moments = Moments::of(&Table::from_rows([[0.0, 1.0], [2.0, 1.0], [4.0, 4.0]]).unwrap());
        let moments = moments.unwrap();
        assert_eq!((moments.count(), moments.mean()), (3, &[2.0, 2.0][..]));
        let covariance = |a, b| moments.covariance(a, b).unwrap();
        assert_eq!(
            [covariance(0, 0), covariance(0, 1), covariance(1, 1)],
            [4.0, 3.0, 3.0]
        );
        assert_eq!(moments.covariance(0, 2), None);
    }

    #[test]
    fn blocks_merge_to_the_whole() {
        let rows: Vec<[f64; 2]> = (0..9)
            .map(|i| [f64::from(i * i), f64::from(7 - i)])
            .collect();
        let of =
            |rows: &[[f64; 2]]| Moments::of(&Table::from_rows(rows.to_vec()).unwrap()).unwrap();
        let merged = of(&rows[..2]).merge(&of(&rows[2..])).unwrap();
        let whole = of(&rows);
        assert_eq!(merged.count(), 9);
        assert!((&merged.mean - &whole.mean).amax() < 1e-12);
        assert!((&merged.scatter - &whole.scatter).amax() < 1e-9);
    }
}
