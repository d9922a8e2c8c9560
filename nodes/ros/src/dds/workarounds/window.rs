//! The unacknowledged samples of a reliable DDS writer.

use std::collections::VecDeque;

/// A reader that lacks this much has fallen behind, even if it lacks few samples \[byte\].
const PATIENCE_BYTES: usize = 16 << 20;
/// The largest window; further samples are refused.
const MOST: usize = 4096;
const MOST_BYTES: usize = 64 << 20;

/// Numbers and sizes of the samples of one DDS writer.
#[derive(Debug, Default)]
pub(in crate::dds) struct Window {
    last: i64,
    /// Of the unacknowledged samples, oldest first \[byte\].
    sizes: VecDeque<usize>,
    bytes: usize,
}

impl Window {
    /// The number of the last sample; 0 before the first.
    pub(in crate::dds) const fn last(&self) -> i64 {
        self.last
    }

    pub(in crate::dds) fn wrote(&mut self, number: i64, len: usize) {
        self.last = number;
        self.sizes.push_back(len);
        self.bytes += len;
    }

    /// All readers have every sample up to `number`.
    pub(in crate::dds) fn acknowledged(&mut self, number: i64) {
        // rustdds acknowledges no sample that was not written
        let left = usize::try_from(self.last - number).unwrap_or(0);
        while self.sizes.len() > left
            && let Some(len) = self.sizes.pop_front()
        {
            self.bytes -= len;
        }
    }

    pub(in crate::dds) fn unacknowledged(&self) -> usize {
        self.sizes.len()
    }

    /// Whether further samples are refused.
    pub(in crate::dds) fn is_full(&self) -> bool {
        self.sizes.len() >= MOST || self.bytes >= MOST_BYTES
    }

    /// Whether some reader is `patience` samples or too many bytes behind.
    pub(in crate::dds) fn is_behind(&self, patience: usize) -> bool {
        self.sizes.len() >= patience || self.bytes >= PATIENCE_BYTES
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unacknowledged_samples_and_bytes_are_counted() {
        let mut window = Window::default();
        for number in 1..=10 {
            window.wrote(number, 100);
        }
        assert_eq!((window.unacknowledged(), window.last()), (10, 10));
        assert!(window.is_behind(10) && !window.is_behind(11));
        window.acknowledged(4);
        assert_eq!(window.unacknowledged(), 6);
        // an older acknowledgement changes nothing
        window.acknowledged(2);
        assert_eq!(window.unacknowledged(), 6);
        window.wrote(11, PATIENCE_BYTES);
        assert!(window.is_behind(1000) && !window.is_full(), "{window:?}");
        window.wrote(12, MOST_BYTES - PATIENCE_BYTES);
        assert!(window.is_full(), "{window:?}");
        window.acknowledged(12);
        assert!(!window.is_behind(1) && window.bytes == 0, "{window:?}");
    }
}
