//! The policy's task: its instruction, encoded.

use std::{fmt, sync::Arc};

use wm_msgs::std_msgs::String as Text;
use wm_zoo::success_probe::Instruction;

/// Longest part of an instruction that is shown \[character\].
const SHOWN: usize = 80;

/// The instruction of the task, and whether it has been encoded. The text tower is slow, so each instruction is encoded once,
/// outside the node's loop.
#[derive(Clone, Debug, Default)]
pub enum Task {
    /// No instruction has arrived, or an empty one.
    #[default]
    Unknown,
    /// It is being encoded.
    Reading(String),
    /// It has been encoded.
    Read(Arc<Instruction>),
    /// It cannot be encoded.
    Refused {
        /// The instruction.
        text: String,
        /// Why not.
        reason: String,
    },
}

impl Task {
    /// Takes an instruction; returns the text to encode, or `None` if it has not changed. Until it is encoded, there is no
    /// instruction: the earlier one is out of date.
    pub fn take(&mut self, message: &Text) -> Option<String> {
        let text = message.data.trim();
        if text == self.text() {
            return None;
        }
        if text.is_empty() {
            *self = Self::Unknown;
            return None;
        }
        *self = Self::Reading(text.to_owned());
        Some(text.to_owned())
    }

    /// Takes the result of encoding `text`; ignores it if another instruction has arrived since.
    pub fn read(&mut self, text: String, outcome: wm_zoo::Result<Instruction>) {
        if !matches!(self, Self::Reading(awaited) if *awaited == text) {
            return;
        }
        *self = match outcome {
            Ok(instruction) => Self::Read(Arc::new(instruction)),
            Err(error) => Self::Refused {
                text,
                reason: error.to_string(),
            },
        };
    }

    /// The instruction, once it has been encoded.
    pub fn instruction(&self) -> Option<Arc<Instruction>> {
        match self {
            Self::Read(instruction) => Some(Arc::clone(instruction)),
            Self::Unknown | Self::Reading(_) | Self::Refused { .. } => None,
        }
    }

    /// Its words; `None` without an instruction.
    pub(super) fn text(&self) -> &str {
        match self {
            Self::Unknown => "",
            Self::Reading(text) | Self::Refused { text, .. } => text,
            Self::Read(instruction) => instruction.text(),
        }
    }
}

/// The instruction that a success probability is for, or why there is none.
impl fmt::Display for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown: String = self.text().chars().take(SHOWN).collect();
        match self {
            Self::Unknown => write!(f, "NaN: no instruction yet"),
            Self::Reading(_) => write!(f, "NaN: the instruction {shown:?} is still being encoded"),
            Self::Read(_) => write!(f, "of {shown:?}"),
            Self::Refused { reason, .. } => {
                write!(
                    f,
                    "NaN: the instruction {shown:?} cannot be encoded: {reason}"
                )
            }
        }
    }
}

#[cfg(test)]
mod tests;
