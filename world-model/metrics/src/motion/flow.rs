use crate::{
    MetricError,
    error::{finite, mean},
};

/// Share of the longest vectors that represent a field's motion (VBench).
pub const TOP_SHARE: f64 = 0.05;

/// Optical flow of a pair of frames: displacement of each pixel of the first frame \[px\].
#[derive(Clone, Debug, PartialEq)]
pub struct Flow {
    width: u32,
    u: Vec<f32>,
    v: Vec<f32>,
}

impl Flow {
    /// A flow from its components to the right `u` and downwards `v` \[px\], row by row: the two planes of a RAFT
    /// output (2, h, w).
    ///
    /// # Errors
    /// [`MetricError::Length`] unless each plane has width x height values; [`MetricError::Empty`];
    /// [`MetricError::NotFinite`].
    pub fn new(width: u32, height: u32, u: Vec<f32>, v: Vec<f32>) -> Result<Self, MetricError> {
        let pixels = width as usize * height as usize;
        for plane in [&u, &v] {
            crate::error::same_length(pixels, plane.len())?;
            finite("flow", plane.iter().copied().map(f64::from))?;
        }
        Ok(Self { width, u, v })
    }

    /// Width and height \[px\].
    #[must_use]
    pub fn dimensions(&self) -> (u32, u32) {
        // `new` checked that both are multiples.
        (self.width, (self.u.len() / self.width as usize) as u32)
    }

    /// The vectors (right, down), row by row \[px\].
    pub fn vectors(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        let pairs = self.u.iter().zip(&self.v);
        pairs.map(|(u, v)| (f64::from(*u), f64::from(*v)))
    }

    /// Lengths of the vectors, row by row \[px\].
    pub fn magnitudes(&self) -> impl Iterator<Item = f64> + '_ {
        self.vectors().map(|(u, v)| u.hypot(v))
    }

    /// Mean length of the longest 5 % of the vectors, rounded down to at least one vector \[px\]: the motion of a pair
    /// in VBench and WorldArena.
    #[must_use]
    pub fn top_mean(&self) -> f64 {
        top_mean(self.magnitudes().collect())
    }

    pub(super) fn at(&self, x: usize, y: usize) -> Option<(f64, f64)> {
        let index = y * self.width as usize + x;
        let (u, v) = (self.u.get(index)?, self.v.get(index)?);
        Some((f64::from(*u), f64::from(*v)))
    }
}

/// Mean of the largest [`TOP_SHARE`] of at least one value.
pub(super) fn top_mean(mut magnitudes: Vec<f64>) -> f64 {
    let count = ((magnitudes.len() as f64 * TOP_SHARE) as usize).max(1);
    if count < magnitudes.len() {
        magnitudes.select_nth_unstable_by(count, |a, b| b.total_cmp(a));
        magnitudes.truncate(count);
    }
    // Sorted, so that the sum does not depend on the selection.
    magnitudes.sort_unstable_by(f64::total_cmp);
    mean(&magnitudes)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn top_mean_is_of_the_longest_twentieth() {
        // Lengths 0, 5, 10 .. 195 of 40 pixels: the mean of 190 and 195.
        let of = |factor: f32| (0..40_u8).map(|i| factor * f32::from(i)).collect();
        let flow = Flow::new(8, 5, of(3.0), of(-4.0)).unwrap();
        assert!((flow.top_mean() - 192.5).abs() < 1e-9);
        assert_eq!(flow.dimensions(), (8, 5));
        let small = Flow::new(2, 1, vec![1.0, 2.0], vec![0.0; 2]).unwrap();
        assert_eq!(small.top_mean(), 2.0);
    }

    #[test]
    fn invalid_flows_are_rejected() {
        let short = Flow::new(2, 2, vec![0.0; 4], vec![0.0; 3]);
        assert!(matches!(
            short,
            Err(MetricError::Length {
                first: 4,
                second: 3
            })
        ));
        assert_eq!(Flow::new(0, 2, vec![], vec![]), Err(MetricError::Empty));
        let nan = Flow::new(1, 1, vec![0.0], vec![f32::NAN]);
        assert!(matches!(nan, Err(MetricError::NotFinite { .. })));
    }
}
