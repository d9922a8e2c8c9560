//! Messages that are missing from the bag.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

/// Messages of a topic that were lost, by the place where it happened.
#[derive(Debug, Default)]
pub struct Loss {
    /// Found no room: in the subscription, whose oldest was dropped, or on the way to the disk.
    queues: AtomicU64,
    /// Came in a form that is no message's.
    undecodable: AtomicU64,
    /// Never came, as shown by gaps in their publishers' sequence numbers; best effort ones too. What was sent before
    /// the first that came, or after the last, leaves no gap.
    missing: AtomicU64,
}

impl Loss {
    /// Counts messages that found no room.
    pub fn count_queues(&self, messages: u64) {
        self.queues.fetch_add(messages, Ordering::Relaxed);
    }

    /// Counts messages in no known form.
    pub fn count_undecodable(&self, messages: u64) {
        self.undecodable.fetch_add(messages, Ordering::Relaxed);
    }

    /// Counts messages that never came.
    pub fn count_missing(&self, messages: u64) {
        self.missing.fetch_add(messages, Ordering::Relaxed);
    }

    /// All of them.
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
    fn each_cause_is_told_of_by_itself() {
        let loss = Loss::default();
        assert_eq!((loss.total(), loss.to_string()), (0, String::new()));
        loss.count_queues(2);
        loss.count_missing(3);
        let text = "2 dropped from a full queue, 3 missing in their publishers' sequence numbers";
        assert_eq!((loss.total(), loss.to_string()), (5, text.to_owned()));
    }
}
