//! Message definitions: of this suite's own types, else of the ROS packages on `AMENT_PREFIX_PATH`.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use crate::{Schema, SchemaEncoding, type_schema};
use wm_msgs::{
    DEFINITIONS, DescriptionError, Message, TypeDescription, diagnostic_msgs, geometry_msgs,
    lifecycle_msgs, rosgraph_msgs, sensor_msgs, std_msgs, tf2_msgs, trajectory_msgs, vision_msgs,
    visualization_msgs,
    wm_msgs::{
        Action, ActionCandidates, ActionChunk, Assessment, CameraState, EnvObservation,
        ExecutorStatus, Goal, Latent, LatentSpace, Plan, Prediction, PredictionError,
    },
};

/// A definition file is text of a few kilobytes; a larger one is no definition.
const FILE_LIMIT: u64 = 1 << 20;

/// A type of more parts than this is refused.
const PARTS_LIMIT: usize = 256;

/// The definition of `package/msg/Type`, or an empty schema where it is found nowhere: the bytes can be recorded
/// and played all the same, only not decoded by who does not know the type.
#[must_use]
pub fn definition(type_name: &str, prefixes: &[PathBuf]) -> Option<Schema> {
    own(type_name).or_else(|| installed(type_name, prefixes))
}

/// The definitions that may be that of a type's publisher, which DDS does not send: that of this suite, then another that is
/// installed. Bytes say which of them fits.
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

/// What stands for a definition that was not found.
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
    let path = std::env::var_os("AMENT_PREFIX_PATH").unwrap_or_default();
    std::env::split_paths(&path)
        .filter(|prefix| !prefix.as_os_str().is_empty())
        .collect()
}

/// A type of this suite.
struct Own {
    name: String,
    dependencies: Vec<(&'static str, &'static str)>,
    schema: fn() -> Schema,
    description: fn() -> Result<TypeDescription, DescriptionError>,
}

fn own_type<M: Message>() -> Own {
    Own {
        name: M::ros_name(),
        dependencies: M::dependencies(),
        schema: type_schema::<M>,
        description: TypeDescription::of::<M>,
    }
}

static OWN: LazyLock<Vec<Own>> = LazyLock::new(|| {
    vec![
        own_type::<std_msgs::Header>(),
        own_type::<std_msgs::String>(),
        own_type::<std_msgs::Bool>(),
        own_type::<std_msgs::Float32>(),
        own_type::<std_msgs::Float64>(),
        own_type::<std_msgs::Float64MultiArray>(),
        own_type::<sensor_msgs::Image>(),
        own_type::<sensor_msgs::CompressedImage>(),
        own_type::<sensor_msgs::CameraInfo>(),
        own_type::<sensor_msgs::JointState>(),
        own_type::<geometry_msgs::Pose>(),
        own_type::<geometry_msgs::PoseStamped>(),
        own_type::<geometry_msgs::TwistStamped>(),
        own_type::<geometry_msgs::PoseArray>(),
        own_type::<diagnostic_msgs::DiagnosticArray>(),
        own_type::<rosgraph_msgs::Clock>(),
        own_type::<tf2_msgs::TFMessage>(),
        own_type::<trajectory_msgs::JointTrajectory>(),
        own_type::<vision_msgs::LabelInfo>(),
        own_type::<visualization_msgs::MarkerArray>(),
        own_type::<lifecycle_msgs::TransitionEvent>(),
        own_type::<LatentSpace>(),
        own_type::<Latent>(),
        own_type::<Action>(),
        own_type::<ActionChunk>(),
        own_type::<ActionCandidates>(),
        own_type::<Assessment>(),
        own_type::<EnvObservation>(),
        own_type::<Goal>(),
        own_type::<Prediction>(),
        own_type::<PredictionError>(),
        own_type::<Plan>(),
        own_type::<CameraState>(),
        own_type::<ExecutorStatus>(),
    ]
});

fn own(type_name: &str) -> Option<Schema> {
    let own = OWN.iter().find(|own| own.name == type_name)?;
    Some((own.schema)())
}

/// What this suite's own type of this name is made of; none for other types.
pub(crate) fn own_description(type_name: &str) -> Option<TypeDescription> {
    let own = OWN.iter().find(|own| own.name == type_name)?;
    // A test holds every type of the suite.
    (own.description)().ok()
}

/// Name and `.msg` text of this suite's own type of this name, or of one that such a type names.
pub(crate) fn known_text(type_name: &str) -> Option<(&'static str, &'static str)> {
    OWN.iter().find_map(|own| {
        let named = own.dependencies.iter().find(|(name, _)| *name == type_name);
        named.copied()
    })
}

fn installed(type_name: &str, prefixes: &[PathBuf]) -> Option<Schema> {
    let mut text = read(type_name, prefixes)?;
    let mut seen = BTreeSet::from([type_name.to_owned()]);
    let mut waiting = parts(type_name, &text);
    while let Some(part) = waiting.pop() {
        if seen.len() > PARTS_LIMIT {
            return None;
        }
        if seen.insert(part.clone()) {
            let definition = read(&part, prefixes)?;
            waiting.extend(parts(&part, &definition));
            let name = part.replace("/msg/", "/");
            // writing to a String cannot fail
            write!(text, "\n{}\nMSG: {name}\n{definition}", "=".repeat(80)).ok();
        }
    }
    Some(Schema::ros2msg(text))
}

fn read(type_name: &str, prefixes: &[PathBuf]) -> Option<String> {
    let (package, name) = type_name.split_once("/msg/")?;
    // names come from the network: nothing but a file name may become part of a path
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
    let installed = prefixes
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
        });
    // The topics of every ROS node, so that a bag can be decoded without a ROS installation.
    let known = || {
        let is_of_nodes = package == "rcl_interfaces" || type_name == "builtin_interfaces/msg/Time";
        let mut all = DEFINITIONS.iter().filter(|_| is_of_nodes);
        let (_, text) = all.find(|(known, _)| *known == type_name)?;
        Some((*text).to_owned())
    };
    installed.or_else(known)
}

/// The message types that a definition's fields have, as `package/msg/Type`.
fn parts(type_name: &str, definition: &str) -> Vec<String> {
    let package = type_name.split('/').next().unwrap_or_default();
    let mut parts = Vec::new();
    for line in definition.lines() {
        let code = line.split('#').next().unwrap_or_default();
        let Some(field_type) = code.split_whitespace().next() else {
            continue;
        };
        let field_type = field_type.split(['[', '<', '=']).next().unwrap_or_default();
        match field_type.split('/').collect::<Vec<_>>().as_slice() {
            [package, name] | [package, "msg", name] => parts.push(format!("{package}/msg/{name}")),
            // types begin with a capital; primitives do not
            [name] if name.starts_with(|c: char| c.is_ascii_uppercase()) => match *name {
                "Header" => parts.push("std_msgs/msg/Header".to_owned()),
                name => parts.push(format!("{package}/msg/{name}")),
            },
            _ => {}
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_types_need_no_ros() {
        let schema = definition("wm_msgs/msg/Prediction", &[]).unwrap();
        assert_eq!(schema, type_schema::<Prediction>());
        assert_eq!(definition("nav_msgs/msg/Odometry", &[]), None);
        let event = definition("rcl_interfaces/msg/ParameterEvent", &[]).unwrap();
        // As ROS 2 Kilted installs it in share/rcl_interfaces/msg/ParameterEvent.json.
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
    fn installed_types_come_with_their_parts_each_once() {
        let folder = tempfile::tempdir().unwrap();
        let write = |package: &str, name: &str, text: &str| {
            let folder = folder.path().join("share").join(package).join("msg");
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join(format!("{name}.msg")), text).unwrap();
        };
        write(
            "a",
            "Top",
            "Header header\nuint8 X=1\nPart[<=3] parts # Comment\nb/Other other\nstring<=5 s\n",
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
