//! The outputs of a convolution that see its input through the same taps.

use super::ConvShape;

/// Outputs of one parity of row and column where the input is doubled first; all outputs otherwise.
///
/// In a doubled input each such output sees each pixel through several taps. Their sum is one tap, so that four
/// convolutions with a quarter of the outputs each do less than half the work of one over the doubled input.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Phase {
    /// Row and column of the first output; the others follow at distances of [`Phase::scale`].
    pub origin: (usize, usize),
    /// For each row of taps the rows of the kernel that it is the sum of, and the same for columns.
    pub rows: Vec<Vec<usize>>,
    pub columns: Vec<Vec<usize>>,
    /// How far the first tap lies before the output's own place: rows, columns.
    pub pad: (isize, isize),
}

impl Phase {
    /// Outputs from one of a phase to the next, in both directions.
    pub(super) const fn scale(shape: &ConvShape) -> usize {
        if shape.upsample { 2 } else { 1 }
    }

    /// Those of a convolution.
    pub(super) fn all(shape: &ConvShape) -> Vec<Self> {
        let scale = Self::scale(shape);
        let origins = (0..scale).flat_map(|row| (0..scale).map(move |column| (row, column)));
        origins
            .map(|origin| {
                let (rows, row_pad) = merged_taps(shape.kernel, scale, origin.0);
                let (columns, column_pad) = merged_taps(shape.kernel, scale, origin.1);
                Self {
                    origin,
                    rows,
                    columns,
                    pad: (row_pad, column_pad),
                }
            })
            .collect()
    }

    /// Rows and columns of taps.
    pub(super) fn taps(&self) -> (usize, usize) {
        (self.rows.len(), self.columns.len())
    }

    /// The kernel's taps (row times its width, plus column) whose sum is tap number `tap`.
    pub(super) fn merged(&self, tap: usize) -> impl Iterator<Item = usize> {
        let (rows, columns) = self.taps();
        // As wide as it is high.
        let kernel = self.rows.iter().map(Vec::len).sum::<usize>();
        debug_assert!(tap < rows * columns);
        let of_row = self.rows.get(tap / columns.max(1)).into_iter().flatten();
        of_row.flat_map(move |row| {
            let of_column = self.columns.get(tap % columns.max(1)).into_iter().flatten();
            of_column.map(move |column| row * kernel + column)
        })
    }
}

/// For the outputs `first`, `first` + `scale`, ..: which of the kernel's taps fall on each input,
/// and how many of these inputs lie before the output's own.
fn merged_taps(kernel: usize, scale: usize, first: usize) -> (Vec<Vec<usize>>, isize) {
    let before = (kernel / 2) as isize;
    let input = |tap: usize| (first as isize + tap as isize - before).div_euclid(scale as isize);
    let mut taps: Vec<Vec<usize>> = Vec::new();
    for tap in 0..kernel {
        match taps.last_mut() {
            Some(merged) if tap > 0 && input(tap) == input(tap - 1) => merged.push(tap),
            _ => taps.push(vec![tap]),
        }
    }
    (taps, -input(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubling_merges_taps() {
        assert_eq!(merged_taps(3, 1, 0), (vec![vec![0], vec![1], vec![2]], 1));
        assert_eq!(merged_taps(3, 2, 0), (vec![vec![0], vec![1, 2]], 1));
        assert_eq!(merged_taps(3, 2, 1), (vec![vec![0, 1], vec![2]], 0));
        assert_eq!(merged_taps(1, 2, 1), (vec![vec![0]], 0));
    }

    #[test]
    fn every_phase_has_each_tap_of_the_kernel_once() {
        for shape in [ConvShape::same(1, 1, 5), ConvShape::up(1, 1)] {
            for phase in Phase::all(&shape) {
                let (rows, columns) = phase.taps();
                let merged = (0..rows * columns).flat_map(|tap| phase.merged(tap));
                let mut taps: Vec<usize> = merged.collect();
                taps.sort_unstable();
                let all = 0..shape.kernel * shape.kernel;
                assert_eq!(taps, all.collect::<Vec<_>>(), "{phase:?}");
            }
        }
    }
}
