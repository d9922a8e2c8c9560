/// The value below which the share `q` of the finite `values` lies; `None` without values.
pub(crate) fn quantile(values: impl IntoIterator<Item = f32>, q: f64) -> Option<f32> {
    let mut sorted: Vec<f32> = values.into_iter().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f32::total_cmp);
    // In range: a share of the length.
    let index = (sorted.len().saturating_sub(1) as f64 * q).round() as usize;
    sorted.get(index).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantile_ignores_values_that_are_not_finite() {
        assert_eq!(quantile([3.0, f32::NAN, 1.0, 2.0], 0.5), Some(2.0));
        assert_eq!(quantile([3.0, 1.0], 1.0), Some(3.0));
        assert_eq!(quantile([f32::NAN], 0.5), None);
    }
}
