//! Passes of the recorder's clock: a new pass begins when the clock steps back.
//!
//! The evidence is a topic whose own log times step back. Log times of the whole file are no evidence: some writers store
//! one topic after another. Nor are latched topics, since recorders repeat them in later files.

use std::{collections::BTreeMap, sync::Arc};

use super::times::{GAP_NS, Times};

/// Limit of passes; later ones are merged into the last one, which then counts twice.
const MOST_PASSES: usize = 256;

/// The log times of a channel.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ChannelTimes {
    first_ns: Option<u64>,
    /// Number of the last pass (from 1), and the latest log time in it \[ns\].
    latest: (usize, u64),
}

/// The passes of one file or of several.
#[derive(Clone, Debug, Default)]
pub(crate) struct Passes {
    all: Vec<Times>,
    /// For several files: the latest log time of each topic in the last pass \[ns\].
    latest_ns: BTreeMap<Arc<str>, u64>,
}

/// Spans of log time (first and last \[ns\]), in order.
pub(crate) type Spans = Vec<(u64, u64)>;

impl Passes {
    /// Adds the next message of a file.
    pub fn take(&mut self, channel: &mut ChannelTimes, log_time_ns: u64) {
        let (pass, latest_ns) = channel.latest;
        let is_open = pass > 0 && pass == self.all.len();
        let is_back = is_open && log_time_ns.saturating_add(GAP_NS) < latest_ns;
        if self.all.is_empty() || (is_back && self.all.len() < MOST_PASSES) {
            self.all.push(Times::default());
        }
        if let Some(open) = self.all.last_mut() {
            open.push(log_time_ns);
        }
        channel.first_ns.get_or_insert(log_time_ns);
        let before_ns = match pass == self.all.len() {
            true => latest_ns,
            false => 0,
        };
        channel.latest = (self.all.len(), before_ns.max(log_time_ns));
    }

    /// Adds the next file, with its topics.
    pub fn append<'a>(
        &mut self,
        next: &Self,
        channels: impl Iterator<Item = (&'a Arc<str>, &'a ChannelTimes)> + Clone,
    ) {
        let is_back = channels.clone().any(|(topic, times)| {
            let ends = times.first_ns.zip(self.latest_ns.get(topic));
            ends.is_some_and(|(first_ns, latest_ns)| first_ns.saturating_add(GAP_NS) < *latest_ns)
        });
        for (number, pass) in next.all.iter().enumerate() {
            let is_new = number > 0 || is_back;
            let has_room = self.all.len() < MOST_PASSES;
            match self.all.last_mut() {
                Some(open) if !is_new || !has_room => open.append(pass),
                _ => self.all.push(pass.clone()),
            }
        }
        if is_back || next.all.len() > 1 {
            self.latest_ns.clear();
        }
        for (topic, times) in channels {
            let (pass, latest_ns) = times.latest;
            if pass > 0 && pass == next.all.len() {
                let known_ns = self.latest_ns.entry(Arc::clone(topic)).or_default();
                *known_ns = latest_ns.max(*known_ns);
            }
        }
    }

    /// The spans that exactly one pass covers without a gap, and the spans that several passes cover.
    pub fn spans(&self) -> (Spans, Spans) {
        // Ends are exclusive.
        let mut edges: Vec<(u128, i32)> = Vec::new();
        for stretch in self.all.iter().flat_map(Times::stretches) {
            edges.push((u128::from(stretch.start_ns), 1));
            edges.push((u128::from(stretch.end_ns) + 1, -1));
        }
        if self.all.len() == MOST_PASSES {
            // The last pass may contain several.
            for stretch in self.all.last().into_iter().flat_map(Times::stretches) {
                edges.push((u128::from(stretch.start_ns), 1));
                edges.push((u128::from(stretch.end_ns) + 1, -1));
            }
        }
        edges.sort_unstable();
        let (mut unbroken, mut doubled) = (Spans::new(), Spans::new());
        let (mut from, mut cover) = (0_u128, 0);
        for (at, change) in edges {
            let ends = (u64::try_from(from), u64::try_from(at.saturating_sub(1)));
            if let (true, (Ok(first_ns), Ok(last_ns))) = (at > from, ends) {
                match cover {
                    0 => {}
                    1 => unbroken.push((first_ns, last_ns)),
                    _ => match doubled.last_mut() {
                        Some((_, end_ns)) if end_ns.checked_add(1) == Some(first_ns) => {
                            *end_ns = last_ns;
                        }
                        _ => doubled.push((first_ns, last_ns)),
                    },
                }
            }
            (from, cover) = (at, cover + change);
        }
        (unbroken, doubled)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const S: u64 = 1_000_000_000;

    /// The spans of a file with these messages (topic, log time \[s\]).
    fn spans(messages: &[(usize, u64)]) -> (Spans, Spans) {
        let mut passes = Passes::default();
        let mut channels = [ChannelTimes::default(); 3];
        for (topic, second) in messages {
            passes.take(&mut channels[*topic], second * S);
        }
        passes.spans()
    }

    fn seconds(of: impl IntoIterator<Item = u64>) -> Vec<(usize, u64)> {
        of.into_iter()
            .flat_map(|second| [(0, second), (1, second)])
            .collect()
    }

    fn s(spans: &[(u64, u64)]) -> Spans {
        spans.iter().map(|(a, b)| (a * S, b * S)).collect()
    }

    #[test]
    fn gap_separates_spans() {
        let found = spans(&seconds((100..110).chain(150..160)));
        assert_eq!(found, (s(&[(100, 109), (150, 159)]), vec![]));
    }

    #[test]
    fn backward_clock_step_doubles_the_overlap() {
        let found = spans(&seconds((100..161).chain(140..201)));
        let unbroken = vec![(100 * S, 140 * S - 1), (160 * S + 1, 200 * S)];
        assert_eq!(found, (unbroken, s(&[(140, 160)])));
        // Without an overlap there are still two spans.
        let found = spans(&seconds((100..106).chain(88..100)));
        assert_eq!(found, (s(&[(88, 99), (100, 105)]), vec![]));
    }

    #[test]
    fn topics_stored_in_sequence_are_one_span() {
        let mut messages: Vec<(usize, u64)> = (100..160).map(|second| (0, second)).collect();
        messages.extend((100..160).map(|second| (1, second)));
        assert_eq!(spans(&messages), (s(&[(100, 159)]), vec![]));
    }

    #[test]
    fn message_at_time_zero_doubles_nothing() {
        let mut messages = seconds(100..130);
        messages.insert(30, (0, 0));
        let (unbroken, doubled) = spans(&messages);
        assert_eq!(doubled, vec![]);
        assert_eq!(unbroken.first(), Some(&(0, 0)));
        assert_eq!(unbroken.last().map(|span| span.1), Some(129 * S));
    }

    #[test]
    fn many_clock_steps_take_bounded_memory() {
        let mut messages = Vec::new();
        for _ in 0..2 * MOST_PASSES {
            messages.extend([(0, 100), (0, 105), (0, 111), (0, 120)]);
        }
        let mut passes = Passes::default();
        let mut channel = ChannelTimes::default();
        for (_, second) in &messages {
            passes.take(&mut channel, second * S);
        }
        assert_eq!(passes.all.len(), MOST_PASSES);
        assert_eq!(passes.spans(), (vec![], s(&[(100, 120)])));
    }

    proptest! {
        /// Each message is in an unbroken or a doubled span, whatever its file.
        #[test]
        fn each_message_is_in_one_span(
            times in prop::collection::vec((0usize..3, 0u64..120), 1..60), at in 0usize..60,
        ) {
            let names: [Arc<str>; 3] = ["/a".into(), "/b".into(), "/c".into()];
            let mut all = Passes::default();
            let (one, two) = times.split_at(at % times.len());
            for part in [one, two] {
                let mut file = Passes::default();
                let mut channels = [ChannelTimes::default(); 3];
                for (topic, second) in part {
                    file.take(&mut channels[*topic], second * S);
                }
                all.append(&file, names.iter().zip(&channels));
            }
            let (unbroken, doubled) = all.spans();
            for (_, second) in &times {
                let count = |spans: &Spans| spans.iter().filter(|(a, b)| (*a..=*b).contains(&(second * S))).count();
                prop_assert_eq!(count(&unbroken) + count(&doubled), 1);
            }
        }
    }

    #[test]
    fn backward_clock_step_between_files_begins_a_pass() {
        let names: [Arc<str>; 2] = ["/a".into(), "/b".into()];
        let mut all = Passes::default();
        for start in [100, 200, 150] {
            let mut file = Passes::default();
            let mut channels = [ChannelTimes::default(); 2];
            for (topic, second) in seconds(start..start + 61) {
                file.take(&mut channels[topic], second * S);
            }
            all.append(&file, names.iter().zip(&channels));
        }
        // The first two files are 40 s apart.
        let (unbroken, doubled) = all.spans();
        assert_eq!(doubled, s(&[(150, 160), (200, 210)]));
        let expected = vec![
            (100 * S, 150 * S - 1),
            (160 * S + 1, 200 * S - 1),
            (210 * S + 1, 260 * S),
        ];
        assert_eq!(unbroken, expected);
    }
}
