//! What a recorder logs about topics: once for each topic, and in few lines however many topics there are. `/rosout`
//! keeps only a limited number of lines, and the names come from others.

use std::collections::BTreeSet;
use std::fmt::Display;
use tracing::{debug, info, warn};
use wm_ros::{Diagnostics, TopicInfo};

/// Names that a line of the log holds.
const NAMES: usize = 10;
/// Topics that are not recorded, and types without a definition, that are reported one by one.
const WARNINGS: usize = 20;
/// Topics that are remembered as not recorded. Beyond them the count stands still.
const MOST_SKIPPED: usize = 10_000;
/// Characters of a name that are shown.
const LONGEST_NAME: usize = 256;

/// What was said, and what is to be said next.
pub(super) struct News {
    diagnostics: Diagnostics,
    /// Topics since the last line.
    recorded: Vec<String>,
    /// Name and type of what is not recorded.
    skipped: BTreeSet<(String, String)>,
    undefined: BTreeSet<String>,
}

impl News {
    pub fn new(diagnostics: Diagnostics) -> Self {
        Self {
            diagnostics,
            recorded: Vec::new(),
            skipped: BTreeSet::new(),
            undefined: BTreeSet::new(),
        }
    }

    /// A topic is recorded from now on.
    pub fn recorded(&mut self, name: &str) {
        debug!("recording {name}");
        self.recorded.push(name.to_owned());
    }

    /// A topic is not recorded. It may be told again at each look at the graph.
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
            let (name, type_name) = (shown(&topic.name), shown(&topic.type_name));
            warn!("{name} ({type_name}) is not recorded: {reason}");
        }
        if total == WARNINGS {
            warn!("further topics of this kind are only counted, on /diagnostics");
        }
    }

    /// Something about the definition of a type.
    pub fn undefined(&mut self, type_name: &str, what: &str) {
        if self.undefined.len() < WARNINGS && self.undefined.insert(type_name.to_owned()) {
            warn!("{} {what}", shown(type_name));
            if self.undefined.len() == WARNINGS {
                warn!("further warnings of this kind are not logged");
            }
        }
    }

    /// Says which topics are recorded since it last said so.
    pub fn tell(&mut self) {
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

/// A name that somebody else chose, fit for a terminal.
fn shown(name: &str) -> String {
    name.escape_debug().take(LONGEST_NAME).collect()
}
