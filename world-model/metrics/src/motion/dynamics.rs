use super::{Flow, flow::top_mean};
use crate::MetricError;

/// Flow length above which a pair of frames counts as moving \[px\] (the paper's tau; VBench's at 256 px).
pub const DYNAMIC_THRESHOLD_PX: f64 = 6.0;

/// Shorter edge at which VBench and WorldArena define the threshold \[px\].
const THRESHOLD_SIDE: f64 = 256.0;
/// Steepness of WorldArena's soft threshold.
const STEEPNESS: f64 = 5.0;

/// The paper's "dynamic degree" as worded (appendix C.2 B): share of a clip's frame pairs whose flow exceeds
/// `threshold_px`. The length of a pair is [`Flow::top_mean`], as in VBench and WorldArena; the paper does not define
/// it.
///
/// # Errors
/// [`MetricError::Empty`] without a pair.
pub fn dynamic_degree(flows: &[Flow], threshold_px: f64) -> Result<f64, MetricError> {
    let above = |flow: &Flow| f64::from(flow.top_mean() > threshold_px);
    mean_of(flows, above)
}

/// The dynamic degree with a soft threshold, as in WorldArena's code (`video_quality/WorldArena/dynamic_degree.py`),
/// which the paper cites for its metrics: the mean over pairs of the logistic function of 5 (m / t - 1), with m from
/// [`Flow::top_mean`]. t is 6 px at a shorter edge of 256 px, and proportional otherwise. WorldArena samples about 8
/// frames per second.
///
/// # Errors
/// [`MetricError::Empty`] without a pair.
pub fn soft_dynamic_degree(flows: &[Flow]) -> Result<f64, MetricError> {
    mean_of(flows, |flow| {
        let (width, height) = flow.dimensions();
        let threshold = DYNAMIC_THRESHOLD_PX * f64::from(width.min(height)) / THRESHOLD_SIDE;
        let excess = flow.top_mean() / threshold - 1.0;
        1.0 / (1.0 + (-STEEPNESS * excess).exp())
    })
}

/// The paper's "flow score" as worded: mean length of the longest 5 % of all flow vectors of all pairs of a clip
/// \[px\]. It contradicts the printed figures: scores of 1.2 to 1.7 px, with 0.77 to 0.84 of the pairs above 6 px; see
/// [`mean_flow`].
///
/// # Errors
/// [`MetricError::Empty`] without a pair.
pub fn flow_score(flows: &[Flow]) -> Result<f64, MetricError> {
    if flows.is_empty() {
        return Err(MetricError::Empty);
    }
    Ok(top_mean(flows.iter().flat_map(Flow::magnitudes).collect()))
}

/// WorldArena's "flow score" (`video_quality/WorldArena/flow_score.py`): mean over pairs of the mean length of all
/// vectors \[px\].
///
/// # Errors
/// [`MetricError::Empty`] without a pair.
pub fn mean_flow(flows: &[Flow]) -> Result<f64, MetricError> {
    mean_of(flows, |flow| {
        let (width, height) = flow.dimensions();
        flow.magnitudes().sum::<f64>() / (f64::from(width) * f64::from(height))
    })
}

fn mean_of(flows: &[Flow], of: impl Fn(&Flow) -> f64) -> Result<f64, MetricError> {
    if flows.is_empty() {
        return Err(MetricError::Empty);
    }
    Ok(flows.iter().map(of).sum::<f64>() / flows.len() as f64)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// Each pixel moves by `px` to the right, one in twenty by twice as much.
    fn flow(px: f32) -> Flow {
        let u = (0..400).map(|i| if i % 20 == 0 { 2.0 * px } else { px });
        Flow::new(20, 20, u.collect(), vec![0.0; 400]).unwrap()
    }

    #[test]
    fn longest_vectors_decide_whether_a_pair_moves() {
        let flows = [flow(2.0), flow(3.0), flow(4.0), flow(0.0)];
        // 4, 6, 8 and 0 px: exactly 6 is not above.
        assert_eq!(dynamic_degree(&flows, DYNAMIC_THRESHOLD_PX), Ok(0.25));
        assert!((flow_score(&flows[2..]).unwrap() - (20.0 * 8.0 + 20.0 * 4.0) / 40.0).abs() < 1e-9);
        assert!((mean_flow(&flows).unwrap() - 9.0 * 1.05 / 4.0).abs() < 1e-9);
    }

    #[test]
    fn soft_degree_is_half_at_the_threshold() {
        let threshold = 6.0 * 20.0 / 256.0;
        let at = soft_dynamic_degree(&[flow(threshold as f32 / 2.0)]).unwrap();
        assert!((at - 0.5).abs() < 1e-6);
        let still = soft_dynamic_degree(&[flow(0.0)]).unwrap();
        assert!((still - 1.0 / (1.0 + 5.0_f64.exp())).abs() < 1e-12);
    }

    #[test]
    fn missing_pairs_are_rejected() {
        assert_eq!(dynamic_degree(&[], 6.0), Err(MetricError::Empty));
        assert_eq!(flow_score(&[]), Err(MetricError::Empty));
        assert_eq!(mean_flow(&[]), Err(MetricError::Empty));
    }
}
