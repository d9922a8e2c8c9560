use wm_msgs::Message;

use crate::BagError;

/// How a schema's text is written, as the MCAP registry names it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum SchemaEncoding {
    /// `.msg` text, each dependency after a line of 80 `=`.
    Ros2Msg,
    /// OMG IDL.
    Ros2Idl,
    /// Anything else; empty when the recorder found no definition. Kept as it was.
    Other(String),
}

impl SchemaEncoding {
    /// The name in the file.
    #[must_use]
    pub fn as_str(&self) -> &str {
        match self {
            Self::Ros2Msg => "ros2msg",
            Self::Ros2Idl => "ros2idl",
            Self::Other(name) => name,
        }
    }
}

impl From<&str> for SchemaEncoding {
    fn from(name: &str) -> Self {
        match name {
            "ros2msg" => Self::Ros2Msg,
            "ros2idl" => Self::Ros2Idl,
            other => Self::Other(other.to_owned()),
        }
    }
}

/// The definition of a message type as a bag carries it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Schema {
    /// How `text` is written.
    pub encoding: SchemaEncoding,
    /// The definition, with those of the types that it names.
    pub text: String,
}

impl Schema {
    /// A schema in `.msg` text with its dependencies.
    #[must_use]
    pub fn ros2msg(text: impl Into<String>) -> Self {
        Self {
            encoding: SchemaEncoding::Ros2Msg,
            text: text.into(),
        }
    }
}

/// The `ros2msg` schema of a Rust message type.
///
/// The type's own text comes first, with no delimiter; each dependency follows a line of exactly 80 `=` and a line
/// `MSG: package/Type` (rosbag2 `docs/message_definition_encoding.md`; the name as rosbag2's own code writes it).
#[must_use]
pub fn type_schema<M: Message>() -> Schema {
    let mut text = M::DEFINITION.trim_end().to_owned();
    text.push('\n');
    for (ros_name, definition) in M::dependencies() {
        text.push_str(&"=".repeat(80));
        text.push_str("\nMSG: ");
        text.push_str(&ros_name.replace("/msg/", "/"));
        text.push('\n');
        text.push_str(definition.trim_end());
        text.push('\n');
    }
    Schema::ros2msg(text)
}

/// A type's name as `package/msg/Type`; takes the short form `package/Type` too.
pub(crate) fn canonical_type_name(name: &str) -> Result<String, BagError> {
    let parts: Vec<&str> = name.split('/').collect();
    match parts.as_slice() {
        [package, kind, type_name]
            if !package.is_empty() && !kind.is_empty() && !type_name.is_empty() =>
        {
            Ok(name.to_owned())
        }
        [package, type_name] if !package.is_empty() && !type_name.is_empty() => {
            Ok(format!("{package}/msg/{type_name}"))
        }
        _ => Err(BagError::TypeName(name.to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schema_text_lists_each_dependency_after_eighty_equal_signs() {
        let text = type_schema::<wm_msgs::sensor_msgs::CompressedImage>().text;
        let parts: Vec<&str> = text.split(&format!("{}\n", "=".repeat(80))).collect();
        assert_eq!(parts.len(), 3, "{text}");
        assert!(parts[0].contains("string format"));
        let mut names: Vec<&str> = parts[1..]
            .iter()
            .map(|part| part.lines().next().unwrap())
            .collect();
        names.sort_unstable();
        assert_eq!(
            names,
            ["MSG: builtin_interfaces/Time", "MSG: std_msgs/Header"]
        );
    }

    #[test]
    fn type_names_are_canonical() {
        assert_eq!(
            canonical_type_name("std_msgs/String").unwrap(),
            "std_msgs/msg/String"
        );
        assert_eq!(
            canonical_type_name("std_msgs/msg/String").unwrap(),
            "std_msgs/msg/String"
        );
        for bad in ["", "String", "/String", "a/b/c/d", "std_msgs//String"] {
            assert!(
                matches!(canonical_type_name(bad), Err(BagError::TypeName(_))),
                "{bad}"
            );
        }
    }
}
