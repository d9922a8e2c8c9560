use nalgebra::DMatrix;

use crate::{
    MetricError,
    error::{at_least, finite},
};

/// A table of finite numbers with at least one row and column: one row per sample (frame, clip, step), one column per
/// feature or action dimension.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    columns: usize,
    values: Vec<f64>,
}

impl Table {
    /// A table from values, row by row.
    ///
    /// # Errors
    /// [`MetricError::Empty`]; [`MetricError::Length`] unless the values fill whole rows; [`MetricError::NotFinite`].
    pub fn new(values: Vec<f64>, columns: usize) -> Result<Self, MetricError> {
        if values.is_empty() || columns == 0 {
            return Err(MetricError::Empty);
        }
        if !values.len().is_multiple_of(columns) {
            return Err(MetricError::Length {
                first: values.len(),
                second: values.len() / columns * columns,
            });
        }
        finite("values of a table", values.iter().copied())?;
        Ok(Self { columns, values })
    }

    /// A table from rows, for example f32 outputs of a network.
    ///
    /// # Errors
    /// [`MetricError::Empty`]; [`MetricError::Length`] if rows differ in length; [`MetricError::NotFinite`].
    pub fn from_rows<R, V>(rows: impl IntoIterator<Item = R>) -> Result<Self, MetricError>
    where
        R: IntoIterator<Item = V>,
        V: Into<f64>,
    {
        let (mut values, mut columns) = (Vec::new(), None);
        for row in rows {
            let before = values.len();
            values.extend(row.into_iter().map(Into::into));
            let (expected, found) = (*columns.get_or_insert(values.len()), values.len() - before);
            if expected != found {
                return Err(MetricError::Length {
                    first: expected,
                    second: found,
                });
            }
        }
        // Without rows, `new` reports 0 columns as empty.
        Self::new(values, columns.unwrap_or(0))
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.values.len() / self.columns
    }

    /// Number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The rows in order.
    pub fn iter(&self) -> std::slice::ChunksExact<'_, f64> {
        self.values.chunks_exact(self.columns)
    }

    /// One column; empty for an unknown index.
    #[must_use]
    pub fn column(&self, column: usize) -> Vec<f64> {
        let values = self.iter().filter_map(|row| row.get(column));
        values.copied().collect()
    }

    pub(crate) fn matrix(&self) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.rows(), self.columns, &self.values)
    }

    pub(crate) fn of_matrix(matrix: &DMatrix<f64>) -> Result<Self, MetricError> {
        Self::new(matrix.transpose().as_slice().to_vec(), matrix.ncols())
    }

    pub(crate) fn require_rows(&self, what: &'static str, least: usize) -> Result<(), MetricError> {
        at_least(what, least, self.rows())
    }
}

impl<'a> IntoIterator for &'a Table {
    type Item = &'a [f64];
    type IntoIter = std::slice::ChunksExact<'a, f64>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn rows_keep_their_order() {
        let table = Table::from_rows([[1.0_f32, 2.0], [3.0, 4.0], [5.0, 6.0]]).unwrap();
        assert_eq!((table.rows(), table.columns()), (3, 2));
        assert_eq!(table.column(1), [2.0, 4.0, 6.0]);
        assert_eq!(Table::of_matrix(&table.matrix()).unwrap(), table);
    }

    #[test]
    fn invalid_tables_are_rejected() {
        let none: [[f64; 2]; 0] = [];
        assert_eq!(Table::from_rows(none), Err(MetricError::Empty));
        let ragged = Table::from_rows([vec![1.0], vec![1.0, 2.0]]);
        let expected = MetricError::Length {
            first: 1,
            second: 2,
        };
        assert_eq!(ragged, Err(expected));
        let nan = Table::new(vec![1.0, f64::NAN], 1).unwrap_err();
        assert!(matches!(nan, MetricError::NotFinite { index: 1, .. }));
        assert!(Table::new(vec![1.0; 3], 2).is_err());
    }
}
