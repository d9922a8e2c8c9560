//! Counts missing samples by gaps in sequence numbers.

use std::{collections::HashMap, hash::Hash};

/// The most remembered publishers; more means restarts, over which gaps need no count.
const MAX_WRITERS: usize = 64;

/// The last number from each publisher, by its identity.
#[derive(Debug)]
pub struct Gaps<Id> {
    last: HashMap<Id, i64>,
}

impl<Id> Default for Gaps<Id> {
    fn default() -> Self {
        Self {
            last: HashMap::new(),
        }
    }
}

impl<Id: Eq + Hash> Gaps<Id> {
    /// The number of missing samples of this publisher before this one. Samples before the first are not missing: a
    /// subscription starts when it joins. A late sample does not count twice.
    pub fn after(&mut self, writer: Id, sequence: i64) -> u64 {
        if self.last.len() >= MAX_WRITERS && !self.last.contains_key(&writer) {
            self.last.clear();
        }
        let last = self.last.entry(writer).or_insert(sequence);
        let missing = sequence.saturating_sub(*last).saturating_sub(1);
        *last = sequence.max(*last);
        // negative for a late sample
        u64::try_from(missing).unwrap_or(0)
    }

    /// As [`after`](Self::after); `None` if the sample, or a later one of its publisher, has arrived.
    pub fn after_new(&mut self, writer: Id, sequence: i64) -> Option<u64> {
        (!self.has(&writer, sequence)).then(|| self.after(writer, sequence))
    }

    /// Whether this sample, or a later one of its publisher, has arrived.
    pub fn has(&self, writer: &Id, sequence: i64) -> bool {
        self.last.get(writer).is_some_and(|last| sequence <= *last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_counted_for_each_publisher() {
        let mut gaps = Gaps::default();
        let (a, b) = ('a', 'b');
        assert_eq!(gaps.after(a, 5), 0, "it joined here");
        assert_eq!(gaps.after(a, 6), 0);
        assert_eq!(gaps.after(b, 1), 0);
        assert_eq!(gaps.after(a, 9), 2);
        assert_eq!(gaps.after(a, 8), 0, "late, not lost twice");
        assert_eq!(gaps.after(a, 10), 0);
        assert!(gaps.has(&a, 9) && gaps.has(&a, 10) && !gaps.has(&a, 11));
        assert!(gaps.has(&b, 1) && !gaps.has(&'c', 1));
    }
}
