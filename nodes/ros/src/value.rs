//! Values of parameters, and the Rust types that hold them.

use std::fmt;

/// A parameter's value: the types of `rcl_interfaces/msg/ParameterValue`.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A truth value.
    Bool(bool),
    /// A whole number.
    Integer(i64),
    /// A number.
    Double(f64),
    /// A text.
    String(String),
    /// Bytes.
    ByteArray(Vec<u8>),
    /// Truth values.
    BoolArray(Vec<bool>),
    /// Whole numbers.
    IntegerArray(Vec<i64>),
    /// Numbers.
    DoubleArray(Vec<f64>),
    /// Texts.
    StringArray(Vec<String>),
}

/// The type of a [`Value`]; the numbers are those of `rcl_interfaces/msg/ParameterType`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Kind {
    /// bool
    Bool = 1,
    /// integer
    Integer = 2,
    /// double
    Double = 3,
    /// string
    String = 4,
    /// byte array
    ByteArray = 5,
    /// bool array
    BoolArray = 6,
    /// integer array
    IntegerArray = 7,
    /// double array
    DoubleArray = 8,
    /// string array
    StringArray = 9,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Bool => "bool",
            Self::Integer => "integer",
            Self::Double => "double",
            Self::String => "string",
            Self::ByteArray => "byte array",
            Self::BoolArray => "bool array",
            Self::IntegerArray => "integer array",
            Self::DoubleArray => "double array",
            Self::StringArray => "string array",
        })
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool(value) => write!(f, "{value}"),
            Self::Integer(value) => write!(f, "{value}"),
            Self::Double(value) => write!(f, "{value:?}"),
            Self::String(value) => write!(f, "\"{value}\""),
            Self::ByteArray(value) => write!(f, "{value:?}"),
            Self::BoolArray(value) => write!(f, "{value:?}"),
            Self::IntegerArray(value) => write!(f, "{value:?}"),
            Self::DoubleArray(value) => write!(f, "{value:?}"),
            Self::StringArray(value) => write!(f, "{value:?}"),
        }
    }
}

impl Value {
    /// The value's type.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Bool(_) => Kind::Bool,
            Self::Integer(_) => Kind::Integer,
            Self::Double(_) => Kind::Double,
            Self::String(_) => Kind::String,
            Self::ByteArray(_) => Kind::ByteArray,
            Self::BoolArray(_) => Kind::BoolArray,
            Self::IntegerArray(_) => Kind::IntegerArray,
            Self::DoubleArray(_) => Kind::DoubleArray,
            Self::StringArray(_) => Kind::StringArray,
        }
    }

    /// Converts the value to `kind` without loss: integers to doubles, an empty array to any array, integers from 0 to
    /// 255 to bytes. `rate: 2` for a double means 2.0.
    pub(crate) fn coerced(self, kind: Kind) -> Result<Self, Self> {
        match (self, kind) {
            (value, kind) if value.kind() == kind => Ok(value),
            // Above 2^53 a double cannot represent every integer; no parameter of this suite is so large.
            (Self::Integer(value), Kind::Double) => Ok(Self::Double(value as f64)),
            (Self::IntegerArray(values), Kind::DoubleArray) => Ok(Self::DoubleArray(
                values.into_iter().map(|value| value as f64).collect(),
            )),
            (Self::IntegerArray(values), Kind::ByteArray) => {
                match values.iter().map(|value| u8::try_from(*value)).collect() {
                    Ok(bytes) => Ok(Self::ByteArray(bytes)),
                    Err(_) => Err(Self::IntegerArray(values)),
                }
            }
            (Self::StringArray(values), kind) if values.is_empty() => match kind {
                Kind::ByteArray => Ok(Self::ByteArray(Vec::new())),
                Kind::BoolArray => Ok(Self::BoolArray(Vec::new())),
                Kind::IntegerArray => Ok(Self::IntegerArray(Vec::new())),
                Kind::DoubleArray => Ok(Self::DoubleArray(Vec::new())),
                _ => Err(Self::StringArray(values)),
            },
            (value, _) => Err(value),
        }
    }

    /// From YAML: a scalar, or a list of scalars of one type.
    ///
    /// # Errors
    /// Names the found value: null, a mapping, a mixed list, an integer beyond 64 bits.
    pub(crate) fn from_yaml(yaml: &serde_yaml_ng::Value) -> Result<Self, String> {
        use serde_yaml_ng::Value as Yaml;
        match yaml {
            Yaml::Bool(value) => Ok(Self::Bool(*value)),
            Yaml::Number(number) => {
                if let Some(value) = number.as_i64() {
                    Ok(Self::Integer(value))
                } else if number.is_u64() {
                    Err(format!(
                        "an integer of at most 64 bits, signed; got {number}"
                    ))
                } else {
                    number
                        .as_f64()
                        .map(Self::Double)
                        .ok_or_else(|| format!("a number; got {number}"))
                }
            }
            Yaml::String(value) => Ok(Self::String(value.clone())),
            Yaml::Sequence(items) => Self::from_yaml_list(items),
            Yaml::Null => Err("a value; got nothing (write '' for an empty string)".to_owned()),
            Yaml::Mapping(_) => Err("a scalar or a list; got a mapping".to_owned()),
            Yaml::Tagged(tagged) => Err(format!("plain YAML; got the tag {}", tagged.tag)),
        }
    }

    fn from_yaml_list(items: &[serde_yaml_ng::Value]) -> Result<Self, String> {
        let items = items
            .iter()
            .map(Self::from_yaml)
            .collect::<Result<Vec<_>, _>>()?;
        let mixed = |items: &[Self]| {
            let kinds: Vec<_> = items.iter().map(|item| item.kind().to_string()).collect();
            format!("a list of one type; got [{}]", kinds.join(", "))
        };
        let has_double = items.iter().any(|item| item.kind() == Kind::Double);
        match items.first() {
            None => Ok(Self::StringArray(Vec::new())),
            Some(Self::Bool(_)) => {
                let values = items.iter().map(bool::from_value).collect::<Option<_>>();
                values.map(Self::BoolArray).ok_or_else(|| mixed(&items))
            }
            Some(Self::Integer(_)) if !has_double => {
                let values = items.iter().map(i64::from_value).collect::<Option<_>>();
                values.map(Self::IntegerArray).ok_or_else(|| mixed(&items))
            }
            Some(Self::Integer(_) | Self::Double(_)) => {
                let doubles = items
                    .iter()
                    .map(|item| item.clone().coerced(Kind::Double).ok());
                let values = doubles
                    .map(|item| f64::from_value(&item?))
                    .collect::<Option<_>>();
                values.map(Self::DoubleArray).ok_or_else(|| mixed(&items))
            }
            Some(Self::String(_)) => {
                let values = items.iter().map(String::from_value).collect::<Option<_>>();
                values.map(Self::StringArray).ok_or_else(|| mixed(&items))
            }
            Some(_) => Err("a list of scalars; got a list of lists".to_owned()),
        }
    }
}

/// A Rust type of parameter values.
pub trait ParameterType: Sized + Clone + Send + Sync + 'static {
    /// The type's name in ROS.
    const KIND: Kind;
    /// The value in ROS' type.
    fn into_value(self) -> Value;
    /// The Rust value; `None` for a value of a different type.
    fn from_value(value: &Value) -> Option<Self>;
}

macro_rules! parameter_types {
    ($($type:ty => $variant:ident),* $(,)?) => {
        $(impl ParameterType for $type {
            const KIND: Kind = Kind::$variant;

            fn into_value(self) -> Value {
                Value::$variant(self)
            }

            fn from_value(value: &Value) -> Option<Self> {
                match value {
                    Value::$variant(value) => Some(value.clone()),
                    _ => None,
                }
            }
        })*
    };
}

parameter_types! {
    bool => Bool, i64 => Integer, f64 => Double, String => String, Vec<u8> => ByteArray, Vec<bool> => BoolArray,
    Vec<i64> => IntegerArray, Vec<f64> => DoubleArray, Vec<String> => StringArray,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn yaml(text: &str) -> Result<Value, String> {
        Value::from_yaml(&serde_yaml_ng::from_str(text).unwrap())
    }

    #[test]
    fn yaml_scalars_and_lists_keep_their_types() {
        assert_eq!(yaml("true"), Ok(Value::Bool(true)));
        assert_eq!(yaml("-3"), Ok(Value::Integer(-3)));
        assert_eq!(yaml("3.0"), Ok(Value::Double(3.0)));
        assert_eq!(yaml("'3'"), Ok(Value::String("3".into())));
        assert_eq!(yaml("[1, 2.5]"), Ok(Value::DoubleArray(vec![1.0, 2.5])));
        assert_eq!(
            yaml("[a, b]"),
            Ok(Value::StringArray(vec!["a".into(), "b".into()]))
        );
    }

    #[test]
    fn what_ros_has_no_type_for_is_refused_by_name() {
        assert!(yaml("[1, a]").unwrap_err().contains("[integer, string]"));
        assert!(yaml("~").unwrap_err().contains("nothing"));
        assert!(yaml("{a: 1}").unwrap_err().contains("mapping"));
        assert!(
            yaml("18446744073709551615")
                .unwrap_err()
                .contains("64 bits")
        );
        assert!(yaml("[[1]]").unwrap_err().contains("list of lists"));
    }

    #[test]
    fn only_lossless_changes_of_type_are_made() {
        assert_eq!(
            Value::Integer(2).coerced(Kind::Double),
            Ok(Value::Double(2.0))
        );
        assert_eq!(
            Value::Double(2.0).coerced(Kind::Integer),
            Err(Value::Double(2.0))
        );
        assert_eq!(
            Value::IntegerArray(vec![1, 255]).coerced(Kind::ByteArray),
            Ok(Value::ByteArray(vec![1, 255]))
        );
        assert_eq!(
            Value::IntegerArray(vec![256]).coerced(Kind::ByteArray),
            Err(Value::IntegerArray(vec![256]))
        );
        assert_eq!(
            Value::StringArray(vec![]).coerced(Kind::BoolArray),
            Ok(Value::BoolArray(vec![]))
        );
    }
}
