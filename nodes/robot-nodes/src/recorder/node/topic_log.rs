//! Log lines about topics: one report for each topic, and few lines for many topics. `/rosout` keeps a limited number
//! of lines, and other machines choose the names.

use std::collections::BTreeSet;
use std::fmt::Display;
use tracing::{debug, info, warn};
use wm_ros::{Diagnostics, TopicInfo};

/// Most names in a log line.
const NAMES: usize = 10;
/// Most warnings about skipped topics, and about types without a definition.
const WARNINGS: usize = 20;
/// Most skipped topics that are counted.
const MOST_SKIPPED: usize = 10_000;
/// Most characters of a name in a log line.
const LONGEST_NAME: usize = 256;

/// The reported topics, and those to report next.
pub(super) struct TopicLog {
    diagnostics: Diagnostics,
    /// Topics since the last log line.
    recorded: Vec<String>,
    /// Names and types of the skipped topics.
    skipped: BTreeSet<(String, String)>,
    undefined: BTreeSet<String>,
}

impl TopicLog {
    pub fn new(diagnostics: Diagnostics) -> Self {
        Self {
            diagnostics,
            recorded: Vec::new(),
            skipped: BTreeSet::new(),
            undefined: BTreeSet::new(),
        }
    }

    /// Notes that a topic is recorded; [`flush`](Self::flush) reports it.
    pub fn recorded(&mut self, name: &str) {
        debug!("recording {name}");
        self.recorded.push(name.to_owned());
    }

    /// Reports once that a topic is not recorded.
    pub fn skipped(&mut self, topic: &TopicInfo, reason: &dyn Display) {
        if self.skipped.len() >= MOST_SKIPPED
            || !self
                .skipped
                .insert((topic.name.clone(), topic.type_name.clone()))
        {
            return;
        }
        let total = self.skipped.len();
        self.diagnostics.set_value("topics skipped [total]", total);
        if total <= WARNINGS {
            let (name, type_name) = (printable(&topic.name), printable(&topic.type_name));
            warn!("{name} ({type_name}) is not recorded: {reason}");
        }
        if total == WARNINGS {
            warn!("further topics of this kind are only counted, on /diagnostics");
        }
    }

    /// Reports once a fault of the definition of a type.
    pub fn undefined(&mut self, type_name: &str, reason: &str) {
        if self.undefined.len() < WARNINGS && self.undefined.insert(type_name.to_owned()) {
            warn!("{} {reason}", printable(type_name));
            if self.undefined.len() == WARNINGS {
                warn!("further warnings of this kind are not logged");
            }
        }
    }

    /// Logs the topics that are recorded since the last call.
    pub fn flush(&mut self) {
        let recorded = std::mem::take(&mut self.recorded);
        let more = recorded.len().saturating_sub(NAMES);
        let names: Vec<&str> = recorded.iter().take(NAMES).map(String::as_str).collect();
        let names = names.join(", ");
        match (names.is_empty(), more) {
            (true, _) => {}
            (false, 0) => info!("recording {names}"),
            (false, more) => info!("recording {names} and {more} more"),
        }
    }
}

/// The printable form of a name from another machine.
fn printable(name: &str) -> String {
    name.escape_debug().take(LONGEST_NAME).collect()
}
