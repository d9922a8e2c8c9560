use serde::{Deserialize, Serialize};

use crate::{MetricError, error::same_length};

/// Share of tracked points that stay visible.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointCoverage {
    /// By step, in \[0, 1\].
    pub per_step: Vec<f64>,
    /// Mean over the steps.
    pub mean: f64,
}

/// The paper's "PCK coverage" (appendix C.2 B): share of the query points (a 16x16 grid on the first frame) that a
/// tracker sees at each step, and its mean. `visible` has one list per step, points in the same order; exclude the
/// first frame, where all are visible. Unlike PCK, it does not use distances to true tracks.
///
/// # Errors
/// [`MetricError::Empty`] without a step or a point; [`MetricError::Length`] if steps differ in the number of points.
pub fn point_coverage<S: AsRef<[bool]>>(visible: &[S]) -> Result<PointCoverage, MetricError> {
    let points = visible.first().ok_or(MetricError::Empty)?.as_ref().len();
    let share = |step: &S| {
        let step = step.as_ref();
        same_length(points, step.len())?;
        Ok(step.iter().filter(|seen| **seen).count() as f64 / points as f64)
    };
    let per_step = visible
        .iter()
        .map(share)
        .collect::<Result<Vec<f64>, MetricError>>()?;
    let mean = crate::error::mean(&per_step);
    Ok(PointCoverage { per_step, mean })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn steps_count_alike() {
        let found = point_coverage(&[[true; 4], [true, false, true, true], [false; 4]]).unwrap();
        assert_eq!(found.per_step, [1.0, 0.75, 0.0]);
        assert!((found.mean - 1.75 / 3.0).abs() < 1e-12);
        assert_eq!(point_coverage::<Vec<bool>>(&[]), Err(MetricError::Empty));
        let ragged = point_coverage(&[vec![true], vec![]]);
        assert!(matches!(ragged, Err(MetricError::Length { .. })));
    }
}
