//! Compares the launch files in `launch-configs/` with the types that ROS 2's launch requires. It is stricter than this
//! crate: for example, `respawn: true` is an error there ("Attribute 'respawn' of Entity 'node' expected to be of type
//! str").

#![allow(clippy::unwrap_used)]

use serde_yaml_ng::{Mapping, Value};
use std::path::Path;

/// Whether `launch` and `launch_ros` (kilted) accept the YAML type for this key; `None` for unknown keys.
fn is_right(action: &str, key: &str, value: &Value) -> Option<bool> {
    let is = match (action, key) {
        ("arg", "name" | "default" | "description")
        | ("let" | "env" | "set_env", "name" | "value")
        | ("remap", "from" | "to")
        | ("choice", "value")
        | ("include", "file")
        | ("param", "name" | "from" | "type")
        | ("node", "pkg" | "exec" | "name" | "namespace" | "args" | "ros_args")
        | ("executable", "cmd" | "name")
        | ("node" | "executable", "cwd" | "launch-prefix" | "output" | "on_exit" | "respawn")
        | (_, "if" | "unless") => value.is_string(),
        // `0` would be an integer, which ROS refuses.
        ("node" | "executable", "respawn_delay" | "sigterm_timeout" | "sigkill_timeout") => {
            value.is_f64()
        }
        ("node" | "executable", "respawn_max_retries") => value.is_i64(),
        ("param", "value") => match value {
            Value::Sequence(items) => items.iter().all(is_scalar),
            scalar => is_scalar(scalar),
        },
        ("launch", "arg" | "let" | "node" | "executable" | "group" | "include" | "set_env") => true,
        ("arg", "choice") | ("node", "param" | "remap" | "env") | ("executable", "env") => {
            value.is_sequence()
        }
        _ => return None,
    };
    Some(is)
}

fn is_scalar(value: &Value) -> bool {
    value.is_string() || value.is_bool() || value.is_number()
}

/// Collects the complaints about an entity and its children.
fn check(action: &str, entity: &Mapping, complaints: &mut Vec<String>) {
    for (key, value) in entity {
        let key = key.as_str().unwrap_or_default();
        if is_right(action, key, value) != Some(true) {
            complaints.push(format!("{action}: {key}: {value:?}"));
        }
        let nested = match value {
            Value::Sequence(items) => items.iter().filter_map(Value::as_mapping).collect(),
            Value::Mapping(mapping) => vec![mapping],
            _ => Vec::new(),
        };
        for entity in nested {
            check(key, entity, complaints);
        }
    }
}

fn complaints(text: &str) -> Vec<String> {
    let file: Value = serde_yaml_ng::from_str(text).unwrap();
    let actions = file["launch"].as_sequence().unwrap();
    let mut complaints = Vec::new();
    for action in actions {
        check("launch", action.as_mapping().unwrap(), &mut complaints);
    }
    complaints
}

#[test]
fn our_launch_files_have_the_types_of_ros() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../launch-configs");
    let mut checked = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.to_string_lossy().ends_with(".launch.yaml") {
            let text = std::fs::read_to_string(&path).unwrap();
            assert_eq!(complaints(&text), [""; 0], "{}", path.display());
            checked += 1;
        }
    }
    assert_eq!(checked, 3);
}

#[test]
fn type_that_ros_refuses_is_found() {
    for (key, wrong) in [
        ("respawn", "true"),
        ("respawn_delay", "1"),
        ("if", "false"),
        ("unheard_of", "x"),
    ] {
        let text = format!("launch:\n- node: {{pkg: a, exec: b, {key}: {wrong}}}\n");
        assert_eq!(complaints(&text).len(), 1, "{key}");
    }
    let right = "launch:\n- node: {pkg: a, exec: b, respawn: 'true', respawn_delay: 0.5}\n";
    assert_eq!(complaints(right), [""; 0]);
}
