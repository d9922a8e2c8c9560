use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::run::RunEnd;

/// Longest text of another process in an error or notice.
const LONGEST_QUOTE: usize = 1000;

/// A message without numbers of the network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "message", rename_all = "snake_case")]
pub enum Message {
    /// First message of a worker.
    Hello {
        /// Version of its program.
        version: String,
        /// Its threads.
        threads: usize,
        /// Description of its data.
        data: Value,
    },
    /// The coordinator accepts the worker.
    Welcome {
        /// Description of the computation, in YAML: JSON rounds floats.
        setup: String,
    },
    /// The coordinator refuses the worker.
    Refused {
        /// Difference.
        reason: String,
    },
    /// The coordinator is alive.
    Ping,
    /// The worker ends on request.
    Leave,
    /// The worker cannot compute.
    Failed {
        /// Cause.
        reason: String,
    },
    /// The training ends.
    End {
        /// State of the training.
        state: EndState,
    },
}

/// Why a coordinator ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndState {
    /// After the last step.
    Finished,
    /// Earlier, on request.
    Stopped,
    /// With an error.
    Failed,
}

impl From<RunEnd> for EndState {
    fn from(end: RunEnd) -> Self {
        match end {
            RunEnd::Finished => Self::Finished,
            RunEnd::Stopped => Self::Stopped,
        }
    }
}

/// A text from another process, safe to print.
pub fn quoted(text: &str) -> String {
    let is_plain = |c: &char| !c.is_control() || *c == '\n';
    let mut quoted: String = text.chars().filter(is_plain).take(LONGEST_QUOTE).collect();
    if quoted.len() < text.len() {
        quoted.push_str(" ...");
    }
    quoted
}
