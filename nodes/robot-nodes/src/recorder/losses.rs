//! Counts of messages that are missing from the bag.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

/// Lost messages of a topic, by cause.
#[derive(Debug, Default)]
pub struct Loss {
    /// Dropped from the full queue of the subscription or of the bag.
    queues: AtomicU64,
    /// Undecodable samples.
    undecodable: AtomicU64,
    /// Gaps in the publishers' sequence numbers, also of best effort publishers. Losses before the first received
    /// message and after the last leave no gap.
    missing: AtomicU64,
}

impl Loss {
    /// Counts messages dropped from a full queue.
    pub fn count_queues(&self, messages: u64) {
        self.queues.fetch_add(messages, Ordering::Relaxed);
    }

    /// Counts undecodable samples.
    pub fn count_undecodable(&self, messages: u64) {
        self.undecodable.fetch_add(messages, Ordering::Relaxed);
    }

    /// Counts missing sequence numbers.
    pub fn count_missing(&self, messages: u64) {
        self.missing.fetch_add(messages, Ordering::Relaxed);
    }

    /// The sum over all causes.
    #[must_use]
    pub fn total(&self) -> u64 {
        [&self.queues, &self.undecodable, &self.missing]
            .iter()
            .map(|count| count.load(Ordering::Relaxed))
            .sum()
    }
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let causes: Vec<String> = [
            (&self.queues, "dropped from a full queue"),
            (&self.undecodable, "undecodable"),
            (
                &self.missing,
                "missing in their publishers' sequence numbers",
            ),
        ]
        .iter()
        .map(|(count, cause)| (count.load(Ordering::Relaxed), cause))
        .filter(|(count, _)| *count > 0)
        .map(|(count, cause)| format!("{count} {cause}"))
        .collect();
        f.write_str(&causes.join(", "))
    }
}

/// Losses by topic.
pub type Losses = BTreeMap<Arc<str>, Arc<Loss>>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loss_text_names_each_cause() {
        let loss = Loss::default();
        assert_eq!((loss.total(), loss.to_string()), (0, String::new()));
        loss.count_queues(2);
        loss.count_missing(3);
        let text = "2 dropped from a full queue, 3 missing in their publishers' sequence numbers";
        assert_eq!((loss.total(), loss.to_string()), (5, text.to_owned()));
    }
}
