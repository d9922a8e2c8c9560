use nalgebra::{DMatrix, DVector};

use super::algebra::freedom;
use crate::{MetricError, Table, error::same_length};

/// The projection of one table: column means, and weights of the differences to them.
#[derive(Clone, Debug)]
pub(super) struct Side {
    means: DVector<f64>,
    pub(super) weights: DMatrix<f64>,
}

impl Side {
    pub(super) fn project(&self, table: &Table, directions: usize) -> Result<Table, MetricError> {
        same_length(self.means.len(), table.columns())?;
        let weights = self
            .weights
            .columns(0, directions.min(self.weights.ncols()));
        let mut values = table.matrix();
        subtract(&mut values, &self.means);
        let projected = values * weights;
        if projected.is_empty() {
            return Err(MetricError::Empty);
        }
        Table::of_matrix(&projected)
    }
}

/// Columns of mean 0 and variance 1, or 0 if constant.
pub(super) struct Standard {
    pub(super) values: DMatrix<f64>,
    means: DVector<f64>,
    /// Standard deviations; 0 if constant.
    pub(super) scales: DVector<f64>,
}

impl Standard {
    pub(super) fn of(table: &Table) -> Self {
        let mut values = table.matrix();
        let varies: Vec<bool> = (values.column_iter())
            .map(|column| {
                column
                    .iter()
                    .any(|value| Some(value) != column.iter().next())
            })
            .collect();
        let means = values.row_mean().transpose();
        subtract(&mut values, &means);
        let freedom = freedom(&values);
        let scales = values.column_iter().zip(varies);
        let scales = scales.map(|(column, varies)| {
            let deviation = (column.norm_squared() / freedom).sqrt();
            if varies { deviation } else { 0.0 }
        });
        let scales = DVector::from_iterator(values.ncols(), scales);
        for (mut column, scale) in values.column_iter_mut().zip(scales.iter()) {
            if *scale > 0.0 {
                column /= *scale;
            } else {
                column.fill(0.0);
            }
        }
        Self {
            values,
            means,
            scales,
        }
    }

    /// The projection by weights of the scaled columns.
    pub(super) fn side(self, mut weights: DMatrix<f64>) -> Side {
        for (mut row, scale) in weights.row_iter_mut().zip(self.scales.iter()) {
            if *scale > 0.0 {
                row /= *scale;
            }
        }
        Side {
            means: self.means,
            weights,
        }
    }
}

fn subtract(values: &mut DMatrix<f64>, means: &DVector<f64>) {
    for (mut column, mean) in values.column_iter_mut().zip(means.iter()) {
        column.add_scalar_mut(-mean);
    }
}
