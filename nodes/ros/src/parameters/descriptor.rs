//! The meaning of a parameter and its allowed values.

use crate::value::Value;
use std::{fmt, ops::RangeInclusive};

/// The allowed values of a number, both ends included.
#[derive(Clone, Debug, PartialEq)]
pub enum Range {
    /// For integers.
    Integers {
        /// The least.
        from: i64,
        /// The greatest.
        to: i64,
    },
    /// For doubles.
    Doubles {
        /// The least.
        from: f64,
        /// The greatest.
        to: f64,
    },
}

impl Range {
    /// Whether the value, or every value of an array, lies in the range. NaN lies in none.
    pub(crate) fn contains(&self, value: &Value) -> bool {
        match (self, value) {
            (Self::Integers { from, to }, Value::Integer(value)) => (from..=to).contains(&value),
            (Self::Integers { from, to }, Value::IntegerArray(values)) => {
                values.iter().all(|value| (from..=to).contains(&value))
            }
            (Self::Doubles { from, to }, Value::Double(value)) => (from..=to).contains(&value),
            (Self::Doubles { from, to }, Value::DoubleArray(values)) => {
                values.iter().all(|value| (from..=to).contains(&value))
            }
            // a range of one type does not restrict values of another
            _ => true,
        }
    }
}

impl From<RangeInclusive<i64>> for Range {
    fn from(range: RangeInclusive<i64>) -> Self {
        let (from, to) = range.into_inner();
        Self::Integers { from, to }
    }
}

impl From<RangeInclusive<f64>> for Range {
    fn from(range: RangeInclusive<f64>) -> Self {
        let (from, to) = range.into_inner();
        Self::Doubles { from, to }
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integers { from, to } => write!(f, "an integer from {from} to {to}"),
            Self::Doubles { from, to } => write!(f, "a double from {from:?} to {to:?}"),
        }
    }
}

/// The meaning of a parameter and its allowed values, as shown by `ros2 param describe`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Descriptor {
    /// Meaning and unit.
    pub description: String,
    /// The values allowed; `None`: all of the type.
    pub range: Option<Range>,
    /// The texts allowed; empty: all.
    pub choices: &'static [&'static str],
    /// Whether the value is fixed while the node runs.
    pub read_only: bool,
}

impl Descriptor {
    /// A parameter of any value, which can be changed while the node runs.
    pub fn new(description: impl Into<String>) -> Self {
        Self {
            description: description.into(),
            ..Self::default()
        }
    }

    /// Allows integers in `from..=to` only.
    #[must_use]
    pub fn integers(self, from: i64, to: i64) -> Self {
        Self {
            range: Some(Range::Integers { from, to }),
            ..self
        }
    }

    /// Allows doubles in `from..=to` only.
    #[must_use]
    pub fn floats(self, from: f64, to: f64) -> Self {
        Self {
            range: Some(Range::Doubles { from, to }),
            ..self
        }
    }

    /// Whether the value is among the choices; `true` without choices.
    pub(crate) fn offers(&self, value: &Value) -> bool {
        match value {
            Value::String(text) if !self.choices.is_empty() => {
                self.choices.contains(&text.as_str())
            }
            _ => true,
        }
    }

    /// The choices as a list.
    pub(crate) fn choices_in_words(&self) -> String {
        match self.choices.split_last() {
            Some((last, [])) => (*last).to_owned(),
            Some((last, others)) => format!("{} or {last}", others.join(", ")),
            None => String::new(),
        }
    }

    /// Fixes the value while the node runs.
    #[must_use]
    pub fn read_only(self) -> Self {
        Self {
            read_only: true,
            ..self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_are_included_and_nan_is_not() {
        let range = Range::Doubles { from: 0.0, to: 1.0 };
        assert!(range.contains(&Value::Double(0.0)) && range.contains(&Value::Double(1.0)));
        assert!(!range.contains(&Value::Double(f64::NAN)));
        assert!(!range.contains(&Value::DoubleArray(vec![0.5, 1.5])));
        assert!(Range::Integers { from: 1, to: 2 }.contains(&Value::Integer(2)));
    }
}
