use nalgebra::{DMatrix, DMatrixView};
use rayon::prelude::*;

use crate::{
    MetricError, Table,
    error::{at_least, finite, same_length},
};

/// Rows of a kernel matrix computed at once: large enough for a fast product; fixed, so that sums do not depend on the
/// number of threads.
const BLOCK: usize = 256;

/// k(x, y) = (scale <x, y> + offset)^degree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolynomialKernel {
    /// Power.
    pub degree: i32,
    /// Factor of the inner product; `None` for 1 / number of features, as in scikit-learn's `polynomial_kernel`.
    pub scale: Option<f64>,
    /// Added to the inner product.
    pub offset: f64,
}

impl PolynomialKernel {
    /// JEDi's kernel (Luo et al. 2024, "Beyond FVD"): degree 2 without offset. Its code (oooolga/JEDi, `mmd_poly`) uses
    /// [`Estimator::Biased`] and reports 100 times the result.
    pub const JEDI: Self = Self {
        degree: 2,
        scale: None,
        offset: 0.0,
    };
    /// Kernel of the kernel inception distance (Bińkowski et al. 2018): cubic with offset 1. torchmetrics'
    /// `KernelInceptionDistance` uses [`Estimator::Unbiased`] on random subsets; on all vectors it equals this one.
    pub const KID: Self = Self {
        degree: 3,
        scale: None,
        offset: 1.0,
    };
}

/// The mean over pairs within a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Estimator {
    /// Without self-pairs: right on average, sometimes below zero.
    Unbiased,
    /// With self-pairs: not below zero except by rounding, but above zero for two draws of one distribution.
    Biased,
}

/// Squared maximum mean discrepancy of the rows of two tables, over all pairs:
/// mean k(x, x') + mean k(y, y') - 2 mean k(x, y).
///
/// Takes 3/2 n^2 d multiplications for n vectors of d features, and the memory of a few blocks.
///
/// # Errors
/// [`MetricError::Length`] if the columns differ in number; [`MetricError::TooFew`] for a single row with the unbiased
/// estimator; [`MetricError::NotFinite`] if kernel values exceed the range of f64.
pub fn maximum_mean_discrepancy(
    first: &Table,
    second: &Table,
    kernel: PolynomialKernel,
    estimator: Estimator,
) -> Result<f64, MetricError> {
    same_length(first.columns(), second.columns())?;
    if estimator == Estimator::Unbiased {
        at_least("vectors", 2, first.rows().min(second.rows()))?;
    }
    // Columns are samples, so that blocks of them are contiguous.
    let (x, y) = (first.matrix().transpose(), second.matrix().transpose());
    let scale = kernel.scale.unwrap_or(1.0 / first.columns() as f64);
    let value = |product: f64| (scale * product + kernel.offset).powi(kernel.degree);
    let within = |samples: &DMatrix<f64>| {
        let count = samples.ncols() as f64;
        let all = sum(samples, samples, &value);
        match estimator {
            Estimator::Biased => all / (count * count),
            Estimator::Unbiased => {
                let own: f64 = samples.column_iter().map(|x| value(x.norm_squared())).sum();
                (all - own) / (count * (count - 1.0))
            }
        }
    };
    let between = sum(&x, &y, &value) / (x.ncols() as f64 * y.ncols() as f64);
    let discrepancy = within(&x) + within(&y) - 2.0 * between;
    finite("kernel values", [discrepancy])?;
    Ok(discrepancy)
}

/// The paper's "JEPA similarity" (appendix C.2 A), in \[0, 1\], 1 for equal sets: exp(-0.4 JEDi). JEDi is 100 times the
/// biased discrepancy of the clips' V-JEPA features under [`PolynomialKernel::JEDI`]. The formula is from WorldArena's
/// code (`video_quality/JEDi/batch.py`), which the paper uses.
///
/// # Errors
/// Those of [`maximum_mean_discrepancy`].
pub fn jepa_similarity(first: &Table, second: &Table) -> Result<f64, MetricError> {
    let (kernel, estimator) = (PolynomialKernel::JEDI, Estimator::Biased);
    let discrepancy = maximum_mean_discrepancy(first, second, kernel, estimator)?;
    Ok((-0.4 * 100.0 * discrepancy.max(0.0)).exp())
}

/// Sum of the kernel over all pairs of columns.
fn sum(x: &DMatrix<f64>, y: &DMatrix<f64>, value: &(impl Fn(f64) -> f64 + Sync)) -> f64 {
    let starts: Vec<usize> = (0..x.ncols()).step_by(BLOCK).collect();
    let sums: Vec<f64> = starts
        .into_par_iter()
        .map(|start| {
            let rows = x.columns(start, BLOCK.min(x.ncols() - start));
            blocks(y)
                .map(|block| {
                    let products = rows.tr_mul(&block);
                    products.iter().map(|product| value(*product)).sum::<f64>()
                })
                .sum()
        })
        .collect();
    sums.iter().sum()
}

fn blocks(matrix: &DMatrix<f64>) -> impl Iterator<Item = DMatrixView<'_, f64>> {
    let starts = (0..matrix.ncols()).step_by(BLOCK);
    starts.map(|start| matrix.columns(start, BLOCK.min(matrix.ncols() - start)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn discrepancy_matches_the_example_of_jedi() {
        // The example of oooolga/JEDi, videojedi/mmd_polynomial.py, whose result is 270.7; the cubic one is
        // scikit-learn's.
        let a = Table::new((1..10).map(f64::from).collect(), 3).unwrap();
        let b = [
            [7.0, 6.0, 5.0],
            [4.0, 3.0, 2.0],
            [1.0, 1.0, 8.0],
            [0.0, 2.0, 5.0],
        ];
        let b = Table::from_rows(b).unwrap();
        let of = |kernel| maximum_mean_discrepancy(&a, &b, kernel, Estimator::Biased).unwrap();
        assert!((of(PolynomialKernel::KID) - 277_057.0 / 12.0).abs() < 1e-6);
        assert!((of(PolynomialKernel::JEDI) - 4873.0 / 18.0).abs() < 1e-9);
        assert!(jepa_similarity(&a, &b).unwrap() < 1e-9);
        assert!((jepa_similarity(&a, &a).unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn blocks_count_every_pair_once() {
        // k = <x, y>: the biased value is the squared distance of the means for any block size.
        let linear = PolynomialKernel {
            degree: 1,
            scale: Some(1.0),
            offset: 0.0,
        };
        let count = 2 * BLOCK + 3;
        let a = Table::new((0..count).map(|i| i as f64).collect(), 1).unwrap();
        let b = Table::new(vec![1.0; BLOCK + 1], 1).unwrap();
        let expected = ((count as f64 - 1.0) / 2.0 - 1.0).powi(2);
        let found = maximum_mean_discrepancy(&a, &b, linear, Estimator::Biased).unwrap();
        assert!((found / expected - 1.0).abs() < 1e-9);
    }

    #[test]
    fn unbiased_estimator_skips_self_pairs() {
        let linear = PolynomialKernel {
            degree: 1,
            scale: Some(1.0),
            offset: 0.0,
        };
        let (a, b) = (
            Table::new(vec![1.0, -1.0], 1).unwrap(),
            Table::new(vec![2.0, 0.0], 1).unwrap(),
        );
        // Within: -1 and 0; between: 0.
        let found = maximum_mean_discrepancy(&a, &b, linear, Estimator::Unbiased).unwrap();
        assert!((found + 1.0).abs() < 1e-12);
        let one = Table::new(vec![1.0], 1).unwrap();
        assert!(maximum_mean_discrepancy(&a, &one, linear, Estimator::Unbiased).is_err());
    }
}
