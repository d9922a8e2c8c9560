use crate::{MetricError, Table};

/// Similarity of a clip's frames, in \[0, 1\]: the mean, over frames from the second on, of the cosine similarities (at
/// least 0) to the first and to the previous frame. `frames` is (frames, features). With DINO's features this is
/// VBench's and the paper's "subject consistency", with CLIP's "background consistency". WorldArena multiplies clips
/// with a [soft dynamic degree](super::soft_dynamic_degree) up to 0.1213 by that degree.
///
/// # Errors
/// [`MetricError::TooFew`] below two frames; [`MetricError::Range`] if all features of a frame are 0.
pub fn feature_consistency(frames: &Table) -> Result<f64, MetricError> {
    frames.require_rows("frames", 2)?;
    let units = frames.iter().map(unit).collect::<Result<Vec<_>, _>>()?;
    let Some(first) = units.first() else {
        return Err(MetricError::Empty);
    };
    let similarity =
        |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>().max(0.0);
    let pairs = units.iter().zip(units.iter().skip(1));
    let each = pairs
        .map(|(before, frame)| f64::midpoint(similarity(first, frame), similarity(before, frame)));
    Ok(each.sum::<f64>() / (units.len() as f64 - 1.0))
}

fn unit(features: &[f64]) -> Result<Vec<f64>, MetricError> {
    let norm = features
        .iter()
        .map(|value| value * value)
        .sum::<f64>()
        .sqrt();
    if norm == 0.0 || !norm.is_finite() {
        return Err(MetricError::Range {
            what: "the length of a frame's features",
            expected: "above 0 and finite",
            actual: norm.to_string(),
        });
    }
    Ok(features.iter().map(|value| value / norm).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn similarity_is_to_first_and_previous_frame() {
        let clip = Table::from_rows([[1.0, 0.0], [0.0, 2.0], [3.0, 3.0]]).unwrap();
        // 0 and 0; then twice the cosine of 45 degrees.
        let expected = 0.5_f64.sqrt() / 2.0;
        assert!((feature_consistency(&clip).unwrap() - expected).abs() < 1e-12);
        let still = Table::from_rows([[1.0, 2.0], [2.0, 4.0]]).unwrap();
        assert!((feature_consistency(&still).unwrap() - 1.0).abs() < 1e-12);
        let opposite = Table::from_rows([[1.0, 2.0], [-1.0, -2.0]]).unwrap();
        assert_eq!(feature_consistency(&opposite), Ok(0.0));
    }

    #[test]
    fn zero_features_are_rejected() {
        let one = Table::from_rows([[1.0, 0.0]]).unwrap();
        assert!(matches!(
            feature_consistency(&one),
            Err(MetricError::TooFew { .. })
        ));
        let zero = Table::from_rows([[1.0, 0.0], [0.0, 0.0]]).unwrap();
        assert!(matches!(
            feature_consistency(&zero),
            Err(MetricError::Range { .. })
        ));
    }
}
