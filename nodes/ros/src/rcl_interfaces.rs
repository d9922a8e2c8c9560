//! The messages of package `rcl_interfaces` that every ROS 2 node speaks: logs, parameters and their services.
//! Fields and order are those of the `.msg` and `.srv` files of ROS 2 Jazzy to Kilted.

use crate::value::{Kind, Value};
use serde::{Deserialize, Serialize};
use wm_msgs::{Message, builtin_interfaces::Time, rcl_interfaces};

/// `rcl_interfaces/msg/Log`: one record of `/rosout`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Log {
    /// When it was logged (node clock).
    pub stamp: Time,
    /// 10 debug, 20 info, 30 warn, 40 error, 50 fatal.
    pub level: u8,
    /// The logger: the node's name.
    pub name: String,
    /// The text.
    pub msg: String,
    /// The source file that logged.
    pub file: String,
    /// The function in it.
    pub function: String,
    /// The line in it.
    pub line: u32,
}

impl Message for Log {
    const PACKAGE: &'static str = "rcl_interfaces";
    const NAME: &'static str = "Log";
    // Its place in that list; a test holds them together.
    const DEFINITION: &'static str = rcl_interfaces::MESSAGES[3].1;

    fn dependencies() -> Vec<(&'static str, &'static str)> {
        vec![("builtin_interfaces/msg/Time", Time::DEFINITION)]
    }
}

/// `ParameterValue`: the type's number, and one field for each type.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct ParameterValue {
    pub(crate) r#type: u8,
    pub(crate) bool_value: bool,
    pub(crate) integer_value: i64,
    pub(crate) double_value: f64,
    pub(crate) string_value: String,
    #[serde(with = "serde_bytes")]
    pub(crate) byte_array_value: Vec<u8>,
    pub(crate) bool_array_value: Vec<bool>,
    pub(crate) integer_array_value: Vec<i64>,
    pub(crate) double_array_value: Vec<f64>,
    pub(crate) string_array_value: Vec<String>,
}

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

impl ParameterValue {
    /// The value; `None` for "not set" and for types that ROS does not have.
    pub(crate) fn into_value(self) -> Option<Value> {
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
        let kind = KINDS.into_iter().find(|kind| *kind as u8 == self.r#type)?;
        Some(match kind {
            Kind::Bool => Value::Bool(self.bool_value),
            Kind::Integer => Value::Integer(self.integer_value),
            Kind::Double => Value::Double(self.double_value),
            Kind::String => Value::String(self.string_value),
            Kind::ByteArray => Value::ByteArray(self.byte_array_value),
            Kind::BoolArray => Value::BoolArray(self.bool_array_value),
            Kind::IntegerArray => Value::IntegerArray(self.integer_array_value),
            Kind::DoubleArray => Value::DoubleArray(self.double_array_value),
            Kind::StringArray => Value::StringArray(self.string_array_value),
        })
    }
}

/// `Parameter`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Parameter {
    pub(crate) name: String,
    pub(crate) value: ParameterValue,
}

/// `ParameterEvent`, sent on `/parameter_events`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct ParameterEvent {
    pub(crate) stamp: Time,
    pub(crate) node: String,
    pub(crate) new_parameters: Vec<Parameter>,
    pub(crate) changed_parameters: Vec<Parameter>,
    pub(crate) deleted_parameters: Vec<Parameter>,
}

/// `FloatingPointRange`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct FloatingPointRange {
    pub(crate) from_value: f64,
    pub(crate) to_value: f64,
    pub(crate) step: f64,
}

/// `IntegerRange`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct IntegerRange {
    pub(crate) from_value: i64,
    pub(crate) to_value: i64,
    pub(crate) step: u64,
}

/// `ParameterDescriptor`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct ParameterDescriptor {
    pub(crate) name: String,
    pub(crate) r#type: u8,
    pub(crate) description: String,
    pub(crate) additional_constraints: String,
    pub(crate) read_only: bool,
    pub(crate) dynamic_typing: bool,
    pub(crate) floating_point_range: Vec<FloatingPointRange>,
    pub(crate) integer_range: Vec<IntegerRange>,
}

/// `SetParametersResult`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct SetParametersResult {
    pub(crate) successful: bool,
    pub(crate) reason: String,
}

/// Request of `GetParameters`, `GetParameterTypes` and `DescribeParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Names {
    pub(crate) names: Vec<String>,
}

/// Response of `GetParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct ParameterValues {
    pub(crate) values: Vec<ParameterValue>,
}

/// Response of `GetParameterTypes`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct ParameterTypes {
    #[serde(with = "serde_bytes")]
    pub(crate) types: Vec<u8>,
}

/// Response of `DescribeParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct ParameterDescriptors {
    pub(crate) descriptors: Vec<ParameterDescriptor>,
}

/// Request of `SetParameters` and `SetParametersAtomically`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct ParametersToSet {
    pub(crate) parameters: Vec<Parameter>,
}

/// Response of `SetParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct SetResults {
    pub(crate) results: Vec<SetParametersResult>,
}

/// Response of `SetParametersAtomically`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct SetResult {
    pub(crate) result: SetParametersResult,
}

/// Request of `ListParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct ListRequest {
    pub(crate) prefixes: Vec<String>,
    pub(crate) depth: u64,
}

/// `LoggerLevel`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct LoggerLevel {
    pub(crate) name: String,
    pub(crate) level: u32,
}

/// Response of `GetLoggerLevels`, and request of `SetLoggerLevels`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct LoggerLevels {
    pub(crate) levels: Vec<LoggerLevel>,
}

/// Response of `SetLoggerLevels`; `SetLoggerLevelsResult` has the fields of `SetParametersResult`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct SetLoggerLevelsResponse {
    pub(crate) results: Vec<SetParametersResult>,
}

/// Response of `ListParameters`: the fields of `ListParametersResult`, which is its one field.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct ListResponse {
    pub(crate) names: Vec<String>,
    pub(crate) prefixes: Vec<String>,
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
            prop_assert_eq!(back.into_value(), Some(value));
        }
    }

    #[test]
    fn the_definition_of_a_log_record_is_its_own() {
        assert_eq!(rcl_interfaces::MESSAGES[3].0, Log::ros_name());
    }

    #[test]
    fn an_unset_value_is_none() {
        assert_eq!(ParameterValue::default().into_value(), None);
        assert_eq!(
            ParameterValue {
                r#type: 10,
                ..ParameterValue::default()
            }
            .into_value(),
            None
        );
    }
}
