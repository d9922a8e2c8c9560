//! Message definitions: this suite's own, and those of the ROS packages on `AMENT_PREFIX_PATH`.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use crate::{Schema, SchemaEncoding};
use wm_msgs::MessageType;

/// A definition file has a few kilobytes; larger files are ignored \[bytes\].
const FILE_LIMIT: u64 = 1 << 20;

/// Limit of the types that a definition uses, directly or not.
const TYPES_LIMIT: usize = 256;

/// The definition of `package/msg/Type`, if this suite or a package under `prefixes` has one. Without a definition, the
/// bytes can be recorded and played, but a reader must know the type.
#[must_use]
pub fn definition(type_name: &str, prefixes: &[PathBuf]) -> Option<Schema> {
    own(type_name).or_else(|| installed(type_name, prefixes))
}

/// Possible definitions of a publisher's type, which DDS does not send: this suite's, then a different installed one.
/// The bytes of a message show which one fits.
#[must_use]
pub fn candidates(type_name: &str, prefixes: &[PathBuf]) -> Vec<Schema> {
    let mut found: Vec<Schema> = own(type_name).into_iter().collect();
    if let Some(installed) = installed(type_name, prefixes) {
        let description = |schema: &Schema| schema.description(type_name).ok().flatten();
        let is_known = found
            .iter()
            .any(|own| description(own) == description(&installed));
        if !is_known {
            found.push(installed);
        }
    }
    found
}

/// The schema for a type without a known definition.
#[must_use]
pub fn unknown() -> Schema {
    Schema {
        encoding: SchemaEncoding::Other(String::new()),
        text: String::new(),
    }
}

/// The folders of `AMENT_PREFIX_PATH`.
#[must_use]
pub fn prefixes() -> Vec<PathBuf> {
    // Unset without a sourced ROS 2: no folders.
    let path = std::env::var_os("AMENT_PREFIX_PATH").unwrap_or_default();
    std::env::split_paths(&path)
        .filter(|prefix| !prefix.as_os_str().is_empty())
        .collect()
}

fn own(type_name: &str) -> Option<Schema> {
    let own = MessageType::find(type_name)?;
    Some(Schema::from_parts(own.definition, own.dependencies()))
}

fn installed(type_name: &str, prefixes: &[PathBuf]) -> Option<Schema> {
    let mut text = read(type_name, prefixes)?;
    let mut known = BTreeSet::from([type_name.to_owned()]);
    let mut pending = field_types(type_name, &text);
    while let Some(part) = pending.pop() {
        if known.len() > TYPES_LIMIT {
            return None;
        }
        if known.insert(part.clone()) {
            let definition = read(&part, prefixes)?;
            pending.extend(field_types(&part, &definition));
            let name = part.replace("/msg/", "/");
            // Writing to a String cannot fail.
            write!(text, "\n{}\nMSG: {name}\n{definition}", "=".repeat(80)).ok();
        }
    }
    Some(Schema::ros2msg(text))
}

fn read(type_name: &str, prefixes: &[PathBuf]) -> Option<String> {
    let (package, name) = type_name.split_once("/msg/")?;
    // Names come from the network: only plain file names may become part of a path.
    let is_plain = |part: &str| {
        !part.is_empty() && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    if !is_plain(package) || !is_plain(name) {
        return None;
    }
    let file = Path::new("share")
        .join(package)
        .join("msg")
        .join(format!("{name}.msg"));
    prefixes
        .iter()
        .map(|prefix| prefix.join(&file))
        .find_map(|path| {
            let is_small =
                std::fs::metadata(&path).is_ok_and(|metadata| metadata.len() <= FILE_LIMIT);
            if is_small {
                std::fs::read_to_string(path).ok()
            } else {
                None
            }
        })
}

/// The message types of a definition's fields, as `package/msg/Type`.
fn field_types(type_name: &str, definition: &str) -> Vec<String> {
    // Never empty below: `split` gives at least one part.
    let package = type_name.split('/').next().unwrap_or_default();
    let mut field_types = Vec::new();
    for line in definition.lines() {
        let code = line.split('#').next().unwrap_or_default();
        let Some(field_type) = code.split_whitespace().next() else {
            continue;
        };
        let field_type = field_type.split(['[', '<', '=']).next().unwrap_or_default();
        match field_type.split('/').collect::<Vec<_>>().as_slice() {
            [package, name] | [package, "msg", name] => {
                field_types.push(format!("{package}/msg/{name}"));
            }
            // Message types begin with a capital, primitives do not.
            [name] if name.starts_with(|c: char| c.is_ascii_uppercase()) => match *name {
                "Header" => field_types.push("std_msgs/msg/Header".to_owned()),
                name => field_types.push(format!("{package}/msg/{name}")),
            },
            _ => {}
        }
    }
    field_types
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::type_schema;
    use wm_msgs::{geometry_msgs::Transform, wm_msgs::Prediction};

    #[test]
    fn own_types_need_no_installed_ros() {
        let schema = definition("wm_msgs/msg/Prediction", &[]).unwrap();
        assert_eq!(schema, type_schema::<Prediction>());
        // A type that only others name.
        let transform = definition("geometry_msgs/msg/Transform", &[]).unwrap();
        assert_eq!(transform, type_schema::<Transform>());
        assert_eq!(definition("nav_msgs/msg/Odometry", &[]), None);
        let event = definition("rcl_interfaces/msg/ParameterEvent", &[]).unwrap();
        // From ROS 2 Kilted: share/rcl_interfaces/msg/ParameterEvent.json.
        let hash = event.type_hash("rcl_interfaces/msg/ParameterEvent");
        assert_eq!(
            hash.unwrap().unwrap().to_string(),
            "RIHS01_043e627780fcad87a22d225bc2a037361dba713fca6a6b9f4b869a5aa0393204"
        );
        let event = event.text;
        for part in [
            "rcl_interfaces/Parameter",
            "rcl_interfaces/ParameterValue",
            "builtin_interfaces/Time",
        ] {
            assert_eq!(
                event.matches(&format!("MSG: {part}\n")).count(),
                1,
                "{part}"
            );
        }
    }

    #[test]
    fn installed_types_list_each_dependency_once() {
        let folder = tempfile::tempdir().unwrap();
        let write = |package: &str, name: &str, text: &str| {
            let folder = folder.path().join("share").join(package).join("msg");
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join(format!("{name}.msg")), text).unwrap();
        };
        write(
            "a",
            "Top",
            "Header header\nuint8 X=1\nPart[<=3] field_types # Comment\nb/Other other\nstring<=5 s\n",
        );
        write("a", "Part", "b/Other again\nfloat64[9] k\n");
        write("b", "Other", "int32 x\n");
        write(
            "std_msgs",
            "Header",
            "builtin_interfaces/Time stamp\nstring frame_id\n",
        );
        write("builtin_interfaces", "Time", "int32 sec\nuint32 nanosec\n");
        let prefixes = [folder.path().to_owned()];
        let schema = definition("a/msg/Top", &prefixes).unwrap();
        assert!(schema.type_hash("a/msg/Top").is_err(), "Header is of ROS 1");
        let text = schema.text;
        assert!(text.starts_with("Header header"));
        for part in [
            "a/Part",
            "b/Other",
            "std_msgs/Header",
            "builtin_interfaces/Time",
        ] {
            assert_eq!(text.matches(&format!("MSG: {part}\n")).count(), 1, "{part}");
        }
        write("c", "Broken", "missing/Type x\n");
        assert_eq!(definition("c/msg/Broken", &prefixes), None);
        assert_eq!(definition("../msg/../../etc/passwd", &prefixes), None);
    }
}
