//! What a node says about bad input: every case is counted and logged, at a limited rate.

use std::{
    collections::BTreeMap,
    fmt::Display,
    time::{Duration, Instant},
};

use crate::{
    Diagnostics, Level,
    logging::printable::{OF_OTHERS, printable},
};

/// Kinds of warnings that are distinguished; texts hold what others send, and could be many.
const KINDS: usize = 64;

/// After a warning, how long more of its kind are only counted.
const QUIET: Duration = Duration::from_secs(5);

/// Counts drops by reason and warns of them.
pub struct Complaints {
    diagnostics: Diagnostics,
    /// By what was said, without its numbers.
    last: BTreeMap<String, (Instant, u64)>,
    waiting_for: Option<String>,
}

impl Complaints {
    /// Complaints of the node of `diagnostics`.
    pub fn new(diagnostics: Diagnostics) -> Self {
        Self {
            diagnostics,
            last: BTreeMap::new(),
            waiting_for: None,
        }
    }

    /// Counts something that was dropped, and says why.
    pub fn left_out(&mut self, reason: &'static str, error: &dyn Display) {
        self.left_out_many(reason, 1, error);
    }

    /// Counts several things that were dropped for one reason, and says why.
    pub fn left_out_many(&mut self, reason: &'static str, number: u64, error: &dyn Display) {
        self.diagnostics.count_drops(reason, number);
        let now = Instant::now();
        // It names what a peer has sent, and goes to the log and to /diagnostics.
        let error = printable(&error.to_string(), OF_OTHERS);
        let text = format!("{reason}: {error}");
        if let Some((subject, level, advice)) = remedy(reason) {
            self.diagnostics
                .raise(subject, level, format!("{error}: {advice}"));
        }
        let mut kind: String = text.chars().filter(|c| !c.is_ascii_digit()).collect();
        if self.last.len() >= KINDS && !self.last.contains_key(&kind) {
            reason.clone_into(&mut kind);
        }
        match self.last.get_mut(&kind) {
            Some((since, unsaid)) if now.duration_since(*since) < QUIET => *unsaid += number,
            earlier => {
                match earlier.map_or(0, |(_, unsaid)| *unsaid) {
                    0 => tracing::warn!("{text}"),
                    unsaid => tracing::warn!("{text} (and {unsaid} more since the last warning)"),
                }
                self.last.insert(kind, (now, 0));
            }
        }
    }

    /// Says what the node waits for: in the status, and in the log where it was not waiting before or what it waits
    /// for (`kind`) is another. Waiting is no drop; every start `is_usual`.
    pub fn waiting(&mut self, kind: &str, is_usual: bool, text: &dyn Display) {
        let text = format!("waiting: {text}");
        if self.waiting_for.as_deref() != Some(kind) {
            if is_usual {
                tracing::info!("{text}");
            } else {
                tracing::warn!("{text}");
            }
            self.waiting_for = Some(kind.to_owned());
        }
        self.diagnostics.set_status(Level::Warn, text);
    }

    /// Says that the node does its work.
    pub fn working(&mut self, text: &str) {
        if self.waiting_for.take().is_some() {
            tracing::info!("{text}");
            self.diagnostics.set_status(Level::Ok, text);
        }
    }
}

/// What an operator can do about a drop for this reason: the subject of its status, how bad it is, and the advice.
fn remedy(reason: &str) -> Option<(&'static str, Level, &'static str)> {
    match reason {
        "wrong_space" => Some((
            "latent space",
            Level::Error,
            "set the same parameter model on encoder, predictor, decoder and planner",
        )),
        "bad_stamp" => Some((
            "stamps",
            Level::Error,
            "it is dropped: nothing is predicted or planned from it",
        )),
        "overload" => Some((
            "overload",
            Level::Warn,
            "give the node more processor time, a higher priority or less work",
        )),
        _ => None,
    }
}
