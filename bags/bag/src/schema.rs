use std::{borrow::Cow, sync::Arc};

use wm_msgs::{DescriptionError, Message, MessageType, TypeDescription, TypeHash, idl_definitions};

use crate::BagError;

/// Equal signs on the line before each dependency.
const DELIMITER: usize = 80;

/// Encoding of a schema's text, by its name in the MCAP registry.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum SchemaEncoding {
    /// `.msg` text; each dependency follows a line of 80 `=`.
    Ros2Msg,
    /// OMG IDL.
    Ros2Idl,
    /// Another encoding, copied unchanged; empty if the recorder found no definition.
    Other(String),
}

impl SchemaEncoding {
    /// The name in MCAP files.
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

/// The definition of a message type in a bag.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Schema {
    /// Encoding of `text`.
    pub encoding: SchemaEncoding,
    /// The definition, and those of the types that it uses.
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

    /// A `ros2msg` schema of a definition and its named dependencies (rosbag2 `docs/message_definition_encoding.md`).
    pub(crate) fn from_parts(
        definition: &str,
        dependencies: impl IntoIterator<Item = (&'static str, &'static str)>,
    ) -> Self {
        let mut text = definition.trim_end().to_owned();
        text.push('\n');
        for (ros_name, definition) in dependencies {
            text.push_str(&"=".repeat(DELIMITER));
            text.push_str("\nMSG: ");
            // Without `msg`, as rosbag2's code writes it.
            text.push_str(&ros_name.replace("/msg/", "/"));
            text.push('\n');
            text.push_str(definition.trim_end());
            text.push('\n');
        }
        Self::ros2msg(text)
    }

    /// The type hash of `package/msg/Type` (REP-2016); `None` unless the schema is `.msg` text.
    ///
    /// # Errors
    /// The text is invalid, or lacks the definition of a type that it uses.
    pub fn type_hash(&self, type_name: &str) -> Result<Option<TypeHash>, DescriptionError> {
        if self.encoding != SchemaEncoding::Ros2Msg {
            return Ok(None);
        }
        let (own, dependencies) = split_definitions(&self.text);
        let description = TypeDescription::message(type_name, own, dependencies)?;
        Ok(Some(description.hash()))
    }

    /// Fields of the type `package/msg/Type`; `None` without a text, or in an encoding other than `ros2msg` and `ros2idl`.
    ///
    /// Some writers omit definitions of known types: types of this suite are added, and `Header` without a package is that of
    /// `std_msgs`.
    ///
    /// # Errors
    /// The text is invalid, or lacks the definition of an unknown type that it uses.
    pub fn description(
        &self,
        type_name: &str,
    ) -> Result<Option<TypeDescription>, DescriptionError> {
        if self.text.trim().is_empty() {
            return Ok(None);
        }
        let (text, definitions);
        let (own, mut dependencies): (&str, Vec<(&str, &str)>) = match self.encoding {
            SchemaEncoding::Ros2Msg => {
                text = with_header_package(&self.text);
                split_definitions(&text)
            }
            SchemaEncoding::Ros2Idl => {
                definitions = idl_definitions(&self.text)?;
                let all = definitions.iter();
                let all: Vec<(&str, &str)> = all
                    .map(|(name, text)| (name.as_str(), text.as_str()))
                    .collect();
                let own = all.iter().find(|(name, _)| *name == type_name);
                let (_, own) = own.ok_or_else(|| DescriptionError::Missing {
                    name: type_name.to_owned(),
                    by: "the schema".to_owned(),
                })?;
                (own, all)
            }
            SchemaEncoding::Other(_) => return Ok(None),
        };
        loop {
            let described = TypeDescription::message(type_name, own, dependencies.iter().copied());
            // Each round adds one missing type.
            match &described {
                Err(DescriptionError::Missing { name, .. }) => match MessageType::find(name) {
                    Some(known) => dependencies.push((known.ros_name, known.definition)),
                    None => return described.map(Some),
                },
                _ => return described.map(Some),
            }
        }
    }

    /// Whether messages with this schema have the fields of `M`. True without a definition.
    #[must_use]
    pub fn has_fields_of<M: Message>(&self) -> bool {
        match (self.description(&M::ros_name()), TypeDescription::of::<M>()) {
            (Ok(Some(theirs)), Ok(ours)) => theirs == ours,
            (Ok(None), Ok(_)) => true,
            _ => false,
        }
    }
}

/// Replaces `Header` (ROS 1) by `std_msgs/Header`, unless a package defines its own `Header`.
fn with_header_package(text: &str) -> Cow<'_, str> {
    let is_bare = |line: &str| {
        let rest = line.trim_start().strip_prefix("Header");
        rest.is_some_and(|rest| rest.starts_with([' ', '\t', '[']))
    };
    let defines_own = |line: &str| {
        let name = line.strip_prefix("MSG: ").map(str::trim);
        name.is_some_and(|name| name.ends_with("/Header") && !name.starts_with("std_msgs/"))
    };
    if !text.lines().any(is_bare) || text.lines().any(defines_own) {
        return Cow::Borrowed(text);
    }
    let lines = text.split_inclusive('\n').map(|line| match is_bare(line) {
        true => Cow::Owned(line.replacen("Header", "std_msgs/Header", 1)),
        false => Cow::Borrowed(line),
    });
    Cow::Owned(lines.collect())
}

/// Splits a text into the type's own definition, and names and definitions of its dependencies.
fn split_definitions(text: &str) -> (&str, Vec<(&str, &str)>) {
    let delimiter = "=".repeat(DELIMITER);
    let mut parts = Vec::new();
    // Start and name of the current part; the first has no name.
    let (mut own, mut start, mut name) = (text, 0, None);
    let mut at = 0;
    let mut lines = text.split_inclusive('\n').peekable();
    while let Some(line) = lines.next() {
        let next = lines
            .peek()
            .copied()
            .and_then(|line| line.strip_prefix("MSG: "));
        if let (true, Some(next)) = (line.trim_end() == delimiter, next) {
            // In range: both are places of lines in `text`.
            let part = text.get(start..at).unwrap_or_default();
            match name.replace(next.trim()) {
                None => own = part,
                Some(name) => parts.push((name, part)),
            }
            at += line.len() + lines.next().map_or(0, str::len);
            start = at;
        } else {
            at += line.len();
        }
    }
    if let Some(name) = name {
        parts.push((name, text.get(start..).unwrap_or_default()));
    }
    (own, parts)
}

/// The `ros2msg` schema of a Rust message type.
#[must_use]
pub fn type_schema<M: Message>() -> Schema {
    Schema::from_parts(M::DEFINITION, M::dependencies())
}

/// The topic name with its leading slash, which some writers omit.
pub(crate) fn absolute(topic: &str) -> Cow<'_, str> {
    match topic.starts_with('/') {
        true => Cow::Borrowed(topic),
        false => Cow::Owned(format!("/{topic}")),
    }
}

/// The channel with a leading slash in its topic name.
pub(crate) fn with_absolute_name(
    channel: &Arc<mcap::Channel<'static>>,
) -> Arc<mcap::Channel<'static>> {
    match absolute(&channel.topic) {
        Cow::Borrowed(_) => Arc::clone(channel),
        Cow::Owned(topic) => {
            let mut channel = mcap::Channel::clone(channel);
            channel.topic = topic;
            Arc::new(channel)
        }
    }
}

/// The type name `package/msg/Type`, also from the short form `package/Type`.
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
    fn dependencies_follow_lines_of_eighty_equal_signs() {
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
    fn schema_has_the_hash_of_its_type() {
        fn hold<M: Message>() {
            let hash = type_schema::<M>().type_hash(&M::ros_name()).unwrap();
            assert_eq!(hash, Some(TypeDescription::of::<M>().unwrap().hash()));
        }
        hold::<wm_msgs::std_msgs::Bool>();
        hold::<wm_msgs::wm_msgs::Prediction>();
        // Writers use both spellings of a dependency's name.
        let text = type_schema::<wm_msgs::std_msgs::Header>()
            .text
            .replace("MSG: builtin_interfaces/", "MSG: builtin_interfaces/msg/");
        assert_eq!(
            Schema::ros2msg(text).type_hash("std_msgs/msg/Header"),
            type_schema::<wm_msgs::std_msgs::Header>().type_hash("std_msgs/msg/Header")
        );
        let lacking = Schema::ros2msg("b/Other x\n").type_hash("a/msg/T");
        assert!(lacking.unwrap_err().to_string().contains("b/msg/Other"));
        let idl = Schema {
            encoding: SchemaEncoding::Ros2Idl,
            text: "module".to_owned(),
        };
        assert_eq!(idl.type_hash("a/msg/T"), Ok(None));
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
