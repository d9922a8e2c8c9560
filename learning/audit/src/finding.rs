//! The result of a check.

use serde::{Deserialize, Serialize};
use std::{borrow::Cow, collections::BTreeMap, fmt};

/// The severity of a finding.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// No fault.
    #[default]
    Ok,
    /// Information; no action needed.
    Note,
    /// Data or nodes work, but worse, or not always.
    Warning,
    /// Data or nodes do not work.
    Error,
}

impl Level {
    fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Note => "note",
            Self::Warning => "WARNING",
            Self::Error => "ERROR",
        }
    }
}

/// The result of a check: verdict, reason, remedy, and measured figures.
///
/// Its [`Display`](fmt::Display) is a line, with reason and remedy on lines of their own below it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// The check, in one word: `camera`.
    pub check: Cow<'static, str>,
    /// The severity.
    pub level: Level,
    /// The verdict.
    pub what: String,
    /// Why it matters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// The remedy: a command, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fix: Option<String>,
    /// Measured figures; names have units: `lag_frames`, `gap_s`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub figures: BTreeMap<String, f64>,
    /// The bags with this finding; empty for findings about all data or live topics.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bags: Vec<String>,
}

impl Finding {
    fn new(check: &'static str, level: Level, what: impl Into<String>) -> Self {
        Self {
            check: check.into(),
            level,
            what: what.into(),
            why: None,
            fix: None,
            figures: BTreeMap::new(),
            bags: Vec::new(),
        }
    }

    /// A check without a fault.
    pub fn ok(check: &'static str, what: impl Into<String>) -> Self {
        Self::new(check, Level::Ok, what)
    }

    /// Information.
    pub fn note(check: &'static str, what: impl Into<String>) -> Self {
        Self::new(check, Level::Note, what)
    }

    /// A fault that impairs data or nodes.
    pub fn warning(check: &'static str, what: impl Into<String>) -> Self {
        Self::new(check, Level::Warning, what)
    }

    /// A fault that makes data or nodes unusable.
    pub fn error(check: &'static str, what: impl Into<String>) -> Self {
        Self::new(check, Level::Error, what)
    }

    /// Adds the reason why it matters.
    #[must_use]
    pub fn because(mut self, why: impl Into<String>) -> Self {
        self.why = Some(why.into());
        self
    }

    /// Adds the remedy.
    #[must_use]
    pub fn fix(mut self, fix: impl Into<String>) -> Self {
        self.fix = Some(fix.into());
        self
    }

    /// Adds a figure, if it is finite.
    #[must_use]
    pub fn figure(mut self, name: &str, value: f64) -> Self {
        // JSON has no NaN.
        if value.is_finite() {
            self.figures.insert(name.to_owned(), value);
        }
        self
    }

    /// Whether it needs action.
    #[must_use]
    pub fn is_fault(&self) -> bool {
        self.level >= Level::Warning
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:<8} {:<10} {}",
            self.level.name(),
            self.check,
            self.what
        )?;
        for (word, text) in [("why:", &self.why), ("fix:", &self.fix)] {
            if let Some(text) = text {
                write!(f, "\n{:20}{word:<6}{text}", "")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn text_has_verdict_reason_and_remedy() {
        let finding = Finding::error("camera", "no image topic")
            .because("nothing is predicted")
            .fix("start the driver");
        assert_eq!(
            finding.to_string(),
            [
                "ERROR    camera     no image topic\n",
                "                    why:  nothing is predicted\n",
                "                    fix:  start the driver",
            ]
            .concat()
        );
        assert_eq!(
            Finding::ok("lag", "0 frames").to_string(),
            "ok       lag        0 frames"
        );
    }

    #[test]
    fn json_is_read_back_and_has_no_nan() {
        let finding = Finding::warning("lag", "2 frames")
            .figure("lag_frames", 2.0)
            .figure("correlation", f64::NAN);
        let json = serde_json::to_string(&finding).unwrap();
        assert!(
            !json.contains("correlation") && !json.contains("why"),
            "{json}"
        );
        assert_eq!(serde_json::from_str::<Finding>(&json).unwrap(), finding);
    }
}
