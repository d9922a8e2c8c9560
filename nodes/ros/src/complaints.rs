//! Warnings about bad input: every case is counted, and logged at a limited rate.

use std::{
    collections::BTreeMap,
    fmt::Display,
    time::{Duration, Instant},
};

use crate::{
    Diagnostics, Level,
    logging::printable::{OF_OTHERS, printable},
};

/// The most kinds of warnings; their texts come from peers and could be many.
const KINDS: usize = 64;

/// After a warning, further ones of its kind are only counted for this long.
const QUIET: Duration = Duration::from_secs(5);

/// Counts drops by reason and warns of them.
pub struct Complaints {
    diagnostics: Diagnostics,
    /// By text, without its numbers.
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

    /// Counts a drop, and logs the reason.
    pub fn left_out(&mut self, reason: &'static str, error: &dyn Display) {
        self.left_out_many(reason, 1, error);
    }

    /// Counts several drops for one reason, and logs it.
    pub fn left_out_many(&mut self, reason: &'static str, number: u64, error: &dyn Display) {
        self.diagnostics.count_drops(reason, number);
        let now = Instant::now();
        // It contains text of peers, and goes to the log and to /diagnostics.
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

    /// Reports in the status what the node waits for, and logs each change of `kind`. Waiting is no drop; during every
    /// start it `is_usual`.
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

    /// Reports that the node works.
    pub fn working(&mut self, text: &str) {
        if self.waiting_for.take().is_some() {
            tracing::info!("{text}");
            self.diagnostics.set_status(Level::Ok, text);
        }
    }
}

/// Advice to the operator on a drop: the subject of its status, the level, and the advice.
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
