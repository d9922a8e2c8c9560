//! The events of the last minute, numbered, as the JSON for clients.

use crate::event::{Event, Stamp};
use serde::Serialize;
use std::collections::VecDeque;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Age \[ns\].
    pub span_ns: i64,
    /// Bytes of JSON.
    pub bytes: usize,
}

/// The most events per message.
const BATCH: usize = 400;

/// Events in order of arrival.
#[derive(Debug)]
pub(crate) struct Journal {
    limits: Limits,
    /// With the time of arrival \[ns\].
    entries: VecDeque<(i64, Box<str>)>,
    bytes: usize,
    /// Number of the first entry.
    first: u64,
}

/// An event with its time of arrival.
#[derive(Serialize)]
struct Entry<'a> {
    at: Stamp,
    #[serde(flatten)]
    event: &'a Event,
}

impl Journal {
    pub(crate) fn new(limits: Limits) -> Self {
        Self {
            limits,
            entries: VecDeque::new(),
            bytes: 0,
            first: 0,
        }
    }

    /// Adds an event that arrived at `now_ns`, and drops the oldest.
    pub(crate) fn add(&mut self, event: &Event, now_ns: i64) {
        let entry = Entry {
            at: Stamp(now_ns),
            event,
        };
        // maps with text keys, and numbers: it cannot fail
        let Ok(json) = serde_json::to_string(&entry) else {
            return;
        };
        self.bytes += json.len();
        self.entries.push_back((now_ns, json.into()));
        let is_old = |then_ns: i64| now_ns.saturating_sub(then_ns) > self.limits.span_ns;
        while let Some((then_ns, _)) = self.entries.front()
            && (self.bytes > self.limits.bytes || is_old(*then_ns))
            && let Some((_, oldest)) = self.entries.pop_front()
        {
            self.bytes -= oldest.len();
            self.first += 1;
        }
    }

    /// The number of the next event.
    pub(crate) fn end(&self) -> u64 {
        self.first + self.entries.len() as u64
    }

    /// The number of the oldest event.
    pub(crate) fn first(&self) -> u64 {
        self.first
    }

    /// A message with the events from number `next` on, as far as they fit, and the number after them; `None` without
    /// events. Contains the number of events that this client has missed.
    pub(crate) fn batch(&self, next: u64) -> Option<(String, u64)> {
        let lost = self.first.saturating_sub(next);
        // at most as many as there are entries
        let skip = next.saturating_sub(self.first) as usize;
        let mut entries = self.entries.iter().skip(skip).take(BATCH).peekable();
        entries.peek()?;
        let mut message = format!("{{\"op\":\"events\",\"lost\":{lost},\"events\":[");
        let mut end = self.first.max(next);
        for (index, (_, json)) in entries.enumerate() {
            if index > 0 {
                message.push(',');
            }
            message.push_str(json);
            end += 1;
        }
        message.push_str("]}");
        Some((message, end))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    fn event(stamp: i64) -> Event {
        Event::Action {
            stamp: Stamp(stamp),
            values: vec![0.5],
        }
    }

    const MINUTE: Limits = Limits {
        span_ns: 60_000_000_000,
        bytes: 1 << 20,
    };

    #[test]
    fn client_gets_each_event_once_and_the_number_missed() {
        let mut journal = Journal::new(MINUTE);
        for stamp in 0..1000 {
            journal.add(&event(stamp), stamp);
        }
        let (mut next, mut got) = (0, Vec::new());
        while let Some((message, end)) = journal.batch(next) {
            let message: Value = serde_json::from_str(&message).unwrap();
            assert_eq!(
                (&message["op"], &message["lost"]),
                (&"events".into(), &0.into())
            );
            let stamps = message["events"].as_array().unwrap().iter();
            got.extend(
                stamps.map(|event| event["stamp"].as_str().unwrap().parse::<i64>().unwrap()),
            );
            next = end;
        }
        assert_eq!(got, (0..1000).collect::<Vec<_>>());
        assert_eq!(next, journal.end());

        journal.add(&event(0), 70_000_000_000);
        assert_eq!(journal.first(), 1000);
        let (message, _) = journal.batch(990).unwrap();
        assert!(message.contains("\"lost\":10,"), "{message}");
    }

    #[test]
    fn memory_is_bounded_by_bytes() {
        let mut journal = Journal::new(Limits {
            bytes: 1000,
            ..MINUTE
        });
        for stamp in 0..10_000 {
            journal.add(&event(stamp), 0);
        }
        let held: usize = journal.entries.iter().map(|(_, json)| json.len()).sum();
        assert!(
            held == journal.bytes && held <= 1000 && held > 900,
            "{held}"
        );
        assert_eq!(journal.end(), 10_000);
    }
}
