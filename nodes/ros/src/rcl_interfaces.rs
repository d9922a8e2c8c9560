//! Values of parameters as messages of `rcl_interfaces`, and back.

use crate::value::{Kind, Value};
use wm_msgs::rcl_interfaces::ParameterValue;

impl From<Value> for ParameterValue {
    fn from(value: Value) -> Self {
        let base = Self {
            r#type: value.kind() as u8,
            ..Self::default()
        };
        match value {
            Value::Bool(value) => Self {
                bool_value: value,
                ..base
            },
            Value::Integer(value) => Self {
                integer_value: value,
                ..base
            },
            Value::Double(value) => Self {
                double_value: value,
                ..base
            },
            Value::String(value) => Self {
                string_value: value,
                ..base
            },
            Value::ByteArray(value) => Self {
                byte_array_value: value,
                ..base
            },
            Value::BoolArray(value) => Self {
                bool_array_value: value,
                ..base
            },
            Value::IntegerArray(value) => Self {
                integer_array_value: value,
                ..base
            },
            Value::DoubleArray(value) => Self {
                double_array_value: value,
                ..base
            },
            Value::StringArray(value) => Self {
                string_array_value: value,
                ..base
            },
        }
    }
}

/// The value; `None` for "not set" and for unknown types.
pub(crate) fn value_of(message: ParameterValue) -> Option<Value> {
    const KINDS: [Kind; 9] = [
        Kind::Bool,
        Kind::Integer,
        Kind::Double,
        Kind::String,
        Kind::ByteArray,
        Kind::BoolArray,
        Kind::IntegerArray,
        Kind::DoubleArray,
        Kind::StringArray,
    ];
    let kind = KINDS
        .into_iter()
        .find(|kind| *kind as u8 == message.r#type)?;
    Some(match kind {
        Kind::Bool => Value::Bool(message.bool_value),
        Kind::Integer => Value::Integer(message.integer_value),
        Kind::Double => Value::Double(message.double_value),
        Kind::String => Value::String(message.string_value),
        Kind::ByteArray => Value::ByteArray(message.byte_array_value),
        Kind::BoolArray => Value::BoolArray(message.bool_array_value),
        Kind::IntegerArray => Value::IntegerArray(message.integer_array_value),
        Kind::DoubleArray => Value::DoubleArray(message.double_array_value),
        Kind::StringArray => Value::StringArray(message.string_array_value),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn value() -> impl Strategy<Value = Value> {
        prop_oneof![
            any::<bool>().prop_map(Value::Bool),
            any::<i64>().prop_map(Value::Integer),
            (-1e9..1e9).prop_map(Value::Double),
            ".{0,9}".prop_map(Value::String),
            prop::collection::vec(any::<u8>(), 0..9).prop_map(Value::ByteArray),
            prop::collection::vec(any::<bool>(), 0..9).prop_map(Value::BoolArray),
            prop::collection::vec(any::<i64>(), 0..9).prop_map(Value::IntegerArray),
            prop::collection::vec(-1e9..1e9, 0..9).prop_map(Value::DoubleArray),
            prop::collection::vec(".{0,9}", 0..9).prop_map(Value::StringArray),
        ]
    }

    proptest! {
        #[test]
        fn values_survive_the_wire(value in value()) {
            let message = ParameterValue::from(value.clone());
            let bytes = wm_msgs::cdr::to_bytes(&message).unwrap();
            let back: ParameterValue = wm_msgs::cdr::from_bytes(&bytes).unwrap();
            prop_assert_eq!(value_of(back), Some(value));
        }
    }

    #[test]
    fn an_unset_value_is_none() {
        assert_eq!(value_of(ParameterValue::default()), None);
        let unknown_type = ParameterValue {
            r#type: 10,
            ..ParameterValue::default()
        };
        assert_eq!(value_of(unknown_type), None);
    }
}
