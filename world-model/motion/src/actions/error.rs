//! Errors of actions and of their descriptions.

use thiserror::Error;

use crate::motion::MAX_CHUNK;

/// An invalid action or description of actions.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum ActionError {
    /// An action with the wrong number of values.
    #[error("an action has {actual} values; expected {expected} of {space}")]
    Length {
        /// Values expected.
        expected: usize,
        /// Values found.
        actual: usize,
        /// The action space, for the message.
        space: String,
    },
    /// Not a number, or infinite.
    #[error("value {index} of an action is {value}, not a finite number")]
    NotFinite {
        /// Index of the value.
        index: usize,
        /// The value.
        value: f32,
    },
    /// A value beyond the reach of any arm in the time of one action.
    #[error("{name} of an action is {value:e} {unit}; at most {limit:.3} is accepted")]
    Implausible {
        /// Name of the dimension.
        name: String,
        /// The value.
        value: f32,
        /// Greatest accepted magnitude.
        limit: f32,
        /// Unit of the dimension.
        unit: String,
    },
    /// A model step with the wrong number of intervals.
    #[error("expected {expected} intervals for a model step, got {actual}")]
    Count {
        /// Intervals of a step.
        expected: usize,
        /// Intervals found.
        actual: usize,
    },
    /// A chunk without actions, with too many, or with an unusable period.
    #[error(
        "action chunk of {count} actions, {period_ns} ns apart: expected 1 to {MAX_CHUNK} actions, 1 ms to 60 s apart"
    )]
    Chunk {
        /// Number of actions.
        count: usize,
        /// Time between actions \[ns\].
        period_ns: i64,
    },
    /// No action at or earlier than this time.
    #[error("no action at {at_ns} ns or earlier")]
    Unknown {
        /// Time requested \[ns\].
        at_ns: i64,
    },
    /// An invalid action space.
    #[error("action space: {0}")]
    Space(String),
    /// An invalid encoding.
    #[error("action encoding: {0}")]
    Encoding(String),
    /// Two different action spaces.
    #[error("action spaces differ: {expected}, but {actual}")]
    Mismatch {
        /// Owner and space expected.
        expected: String,
        /// Owner and space found.
        actual: String,
    },
}
