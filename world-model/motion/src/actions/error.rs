//! What can be wrong with an action.

use thiserror::Error;

use crate::motion::MAX_CHUNK;

/// What can be wrong with an action, or with what describes it.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum ActionError {
    /// Not as many values as the action space has.
    #[error("an action has {actual} values; expected {expected} of {space}")]
    Length {
        /// Values expected.
        expected: usize,
        /// Values that came.
        actual: usize,
        /// The action space, in words.
        space: String,
    },
    /// Not a number, or infinite.
    #[error("value {index} of an action is {value}, not a finite number")]
    NotFinite {
        /// Which value.
        index: usize,
        /// What it was.
        value: f32,
    },
    /// More than an arm reaches in the time of one action.
    #[error("{name} of an action is {value:e} {unit}; at most {limit:.3} is accepted")]
    Implausible {
        /// The dimension.
        name: String,
        /// What it was.
        value: f32,
        /// Greatest magnitude that is accepted.
        limit: f32,
        /// Its unit.
        unit: String,
    },
    /// A model step got another number of intervals than it spans.
    #[error("expected {expected} intervals for a model step, got {actual}")]
    Count {
        /// Intervals of a step.
        expected: usize,
        /// Intervals that came.
        actual: usize,
    },
    /// A chunk that says nothing about when or what.
    #[error(
        "action chunk of {count} actions, {period_ns} ns apart: expected 1 to {MAX_CHUNK} actions, 1 ms to 60 s apart"
    )]
    Chunk {
        /// How many actions.
        count: usize,
        /// Their period \[ns\].
        period_ns: i64,
    },
    /// No action is known for a moment, nor for one before.
    #[error("no action is known for {at_ns} ns or before")]
    Unknown {
        /// The moment.
        at_ns: i64,
    },
    /// A description of actions that cannot be used.
    #[error("action space: {0}")]
    Space(String),
    /// The encoding itself cannot be used.
    #[error("action encoding: {0}")]
    Encoding(String),
    /// Actions of another space.
    #[error("action spaces differ: {expected}, but {actual}")]
    Mismatch {
        /// Who takes which space.
        expected: String,
        /// Who has which.
        actual: String,
    },
}
