//! How large the inputs of a matrix become.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

/// The largest absolute value of every input of a matrix, over all rows that it was multiplied with. Clones share it.
#[derive(Clone, Debug)]
pub struct InputRange(Arc<[AtomicU32]>);

impl InputRange {
    /// Of nothing so far.
    pub fn new(inputs: usize) -> Self {
        Self((0..inputs).map(|_| AtomicU32::new(0)).collect())
    }

    /// Takes rows into account.
    pub(super) fn note(&self, x: &[f32]) {
        let mut largest = vec![0f32; self.0.len()];
        for row in x.chunks_exact(largest.len().max(1)) {
            for (most, value) in largest.iter_mut().zip(row) {
                let value = value.abs();
                // What is no number stays, and so is found.
                if value > *most || value.is_nan() {
                    *most = value;
                }
            }
        }
        for (most, value) in self.0.iter().zip(largest) {
            // The bits of positive numbers are in their order, those of what is no number above all.
            most.fetch_max(value.to_bits(), Ordering::Relaxed);
        }
    }

    /// The largest values so far: zeros if there were none.
    pub fn largest(&self) -> Vec<f32> {
        let values = self.0.iter().map(|most| most.load(Ordering::Relaxed));
        values.map(f32::from_bits).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_of_all_rows_is_kept() {
        let range = InputRange::new(3);
        assert_eq!(range.largest(), [0.0; 3]);
        range.note(&[1.0, -2.0, 0.5, -3.0, 1.0, -0.0]);
        range.clone().note(&[0.0, -2.5, 0.25]);
        assert_eq!(range.largest(), [3.0, 2.5, 0.5]);
        range.note(&[0.0, f32::NAN, 0.0, 0.0, f32::INFINITY, f32::INFINITY]);
        let [first, second, third] = range.largest().try_into().unwrap();
        assert!(first == 3.0 && second.is_nan() && third.is_infinite());
    }
}
