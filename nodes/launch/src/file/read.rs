//! Reads the entries of a launch file: one function per action.

use super::{Action, ActionKind, Argument, Node, Parameter, ParameterValue, ProcessKeys, Scalar};
use crate::{
    entity::{Entity, describe},
    error::LaunchError,
    substitution::Template,
};
use serde_yaml_ng::Value;
use std::path::Path;

/// The deepest nesting of groups; the reader is recursive.
const DEPTH_LIMIT: usize = 16;

/// The known actions, for error messages.
const ACTIONS: [&str; 9] = [
    "arg",
    "let",
    "set_env",
    "unset_env",
    "push_ros_namespace",
    "group",
    "include",
    "node",
    "executable",
];

/// The known types of parameters.
const PARAMETER_TYPES: [&str; 9] = [
    "str",
    "bool",
    "int",
    "float",
    "list_of_str",
    "list_of_bool",
    "list_of_int",
    "list_of_float",
    "yaml",
];

pub(super) fn read_actions(
    file: &Path,
    list: &str,
    entries: &Value,
    depth: usize,
) -> Result<Vec<Action>, LaunchError> {
    let error = |entry: String, message: String| LaunchError::Entry {
        file: file.to_owned(),
        entry,
        message,
    };
    let Value::Sequence(items) = entries else {
        return Err(error(
            list.to_owned(),
            format!("expected a list of actions, got {}", describe(entries)),
        ));
    };
    if depth > DEPTH_LIMIT {
        return Err(error(
            list.to_owned(),
            format!("groups nested more than {DEPTH_LIMIT} deep"),
        ));
    }
    let mut actions = Vec::with_capacity(items.len());
    for (index, item) in items.iter().enumerate() {
        let entry = format!("{list}[{index}]");
        let single = item
            .as_mapping()
            .filter(|mapping| mapping.len() == 1)
            .and_then(|mapping| mapping.iter().next());
        let Some((Value::String(kind), body)) = single else {
            let message = format!(
                "expected a mapping with one key, the action; got {}",
                describe(item)
            );
            return Err(error(entry, message));
        };
        actions.push(read_action(file, entry, kind, body, depth)?);
    }
    Ok(actions)
}

fn read_action(
    file: &Path,
    entry: String,
    kind: &str,
    body: &Value,
    depth: usize,
) -> Result<Action, LaunchError> {
    let label = ["name", "exec", "file", "namespace"]
        .iter()
        .find_map(|key| body.get(*key).and_then(Value::as_str));
    let entry = match label {
        Some(label) => format!("{entry} {kind} {label:?}"),
        None => format!("{entry} {kind}"),
    };
    // `group:` may be a bare list of its children
    if kind == "group" && body.is_sequence() {
        let actions = read_actions(file, &entry, body, depth + 1)?;
        return Ok(Action {
            entry,
            only_if: None,
            unless: None,
            kind: ActionKind::Group {
                scoped: true,
                actions,
            },
        });
    }
    let mut entity = Entity::new(file, entry, body)?;
    let only_if = entity.boolean("if")?;
    let unless = entity.boolean("unless")?;
    if only_if.is_some() && unless.is_some() {
        return Err(entity.error("give either \"if\" or \"unless\", not both".to_owned()));
    }
    let kind = match kind {
        "arg" => ActionKind::Argument(read_argument(&mut entity)?),
        "let" => ActionKind::Let {
            name: entity.required_template("name")?,
            value: entity.required_template("value")?,
        },
        "set_env" => ActionKind::Environment {
            name: entity.required_template("name")?,
            value: Some(entity.required_template("value")?),
        },
        "unset_env" => ActionKind::Environment {
            name: entity.required_template("name")?,
            value: None,
        },
        "push_ros_namespace" | "push-ros-namespace" => {
            ActionKind::PushNamespace(entity.required_template("namespace")?)
        }
        "group" => {
            let scoped = match entity.value("scoped") {
                None | Some(Value::Bool(true)) => true,
                Some(Value::Bool(false)) => false,
                Some(other) => {
                    return Err(entity.error(format!(
                        "key \"scoped\" must be a boolean, got {}",
                        describe(other)
                    )));
                }
            };
            let Some(children) = entity.value("children") else {
                return Err(entity.missing("children"));
            };
            ActionKind::Group {
                scoped,
                actions: read_actions(file, &entity.entry, children, depth + 1)?,
            }
        }
        "include" => ActionKind::Include {
            file: entity.required_template("file")?,
            arguments: read_pairs(&mut entity, "arg", "name", "value")?,
        },
        "node" => ActionKind::Node(Box::new(read_node(&mut entity)?)),
        "executable" => {
            let command = entity.required_template("cmd")?;
            ActionKind::Executable {
                command,
                process: read_process(&mut entity)?,
            }
        }
        other => {
            let message = format!(
                "unknown action {other:?}; known here: {}",
                ACTIONS.join(", ")
            );
            return Err(entity.error(message));
        }
    };
    let entry = entity.entry.clone();
    entity.finish()?;
    Ok(Action {
        entry,
        only_if,
        unless,
        kind,
    })
}

fn read_argument(entity: &mut Entity<'_>) -> Result<Argument, LaunchError> {
    let name = entity.required_text("name")?.to_owned();
    let default_text = entity.text("default")?.map(ToOwned::to_owned);
    let default = entity.template("default")?;
    let description = entity.text("description")?.map(ToOwned::to_owned);
    let mut choices = Vec::new();
    for mut choice in entity.entities("choice")? {
        choices.push(choice.required_text("value")?.to_owned());
        choice.finish()?;
    }
    Ok(Argument {
        name,
        default,
        default_text,
        description,
        choices,
    })
}

fn read_node(entity: &mut Entity<'_>) -> Result<Node, LaunchError> {
    let package = entity.required_template("pkg")?;
    let executable = entity.required_template("exec")?;
    let namespace = entity.template("namespace")?;
    let arguments = entity.template("args")?;
    let ros_arguments = entity.template("ros_args")?;
    let remaps = read_pairs(entity, "remap", "from", "to")?;
    let mut parameters = Vec::new();
    for mut parameter in entity.entities("param")? {
        if let Some(file) = parameter.template("from")? {
            parameter.finish()?;
            parameters.push(Parameter::File(file));
        } else {
            read_parameter(parameter, "", &mut parameters, 0)?;
        }
    }
    let process = read_process(entity)?;
    Ok(Node {
        package,
        executable,
        namespace,
        arguments,
        ros_arguments,
        remaps,
        parameters,
        process,
    })
}

fn read_parameter(
    mut entity: Entity<'_>,
    prefix: &str,
    parameters: &mut Vec<Parameter>,
    depth: usize,
) -> Result<(), LaunchError> {
    let Some(name) = entity.text("name")? else {
        return Err(
            entity.error("a parameter needs \"name\" and \"value\", or \"from\"".to_owned())
        );
    };
    let name = if prefix.is_empty() {
        name.to_owned()
    } else {
        format!("{prefix}.{name}")
    };
    let template = entity.parse("name", &name)?;
    let wanted_type = entity.text("type")?;
    if let Some(other) = wanted_type.filter(|name| !PARAMETER_TYPES.contains(name)) {
        let message = format!(
            "key \"type\" must be one of {}, got {other:?}",
            PARAMETER_TYPES.join(", ")
        );
        return Err(entity.error(message));
    }
    let value = entity.value("value");
    let nested = entity.entities("param")?;
    match (value, nested.is_empty()) {
        (Some(value), true) => {
            let value = match value {
                Value::Sequence(items) => {
                    let items = items.iter().map(|item| read_scalar(&entity, item));
                    ParameterValue::List(items.collect::<Result<_, _>>()?)
                }
                scalar => ParameterValue::One(read_scalar(&entity, scalar)?),
            };
            parameters.push(Parameter::Value {
                name: template,
                value,
                wanted: wanted_type.map(ToOwned::to_owned),
            });
        }
        (None, false) if depth < DEPTH_LIMIT => {
            for child in nested {
                read_parameter(child, &name, parameters, depth + 1)?;
            }
        }
        _ => {
            return Err(
                entity.error("a parameter needs either \"value\" or nested \"param\"".to_owned())
            );
        }
    }
    entity.finish()
}

fn read_scalar(entity: &Entity<'_>, value: &Value) -> Result<Scalar, LaunchError> {
    match value {
        Value::String(text) => Ok(Scalar::Text(entity.parse("value", text)?)),
        Value::Bool(_) | Value::Number(_) => Ok(Scalar::Literal(value.clone())),
        other => Err(entity.error(format!(
            "key \"value\" must be a scalar or a list of scalars, got {}",
            describe(other)
        ))),
    }
}

fn read_pairs(
    entity: &mut Entity<'_>,
    key: &'static str,
    left: &'static str,
    right: &'static str,
) -> Result<Vec<(Template, Template)>, LaunchError> {
    let mut pairs = Vec::new();
    for mut pair in entity.entities(key)? {
        pairs.push((
            pair.required_template(left)?,
            pair.required_template(right)?,
        ));
        pair.finish()?;
    }
    Ok(pairs)
}

fn read_process(entity: &mut Entity<'_>) -> Result<ProcessKeys, LaunchError> {
    let ends_launch = match entity.text("on_exit")? {
        None => false,
        Some("shutdown") => true,
        Some(other) => {
            return Err(entity.error(format!(
                "key \"on_exit\" must be \"shutdown\", got {other:?}"
            )));
        }
    };
    let respawn_max_retries = match entity.value("respawn_max_retries") {
        None => None,
        // in ROS 2, a negative number means unlimited
        Some(value) => match value.as_i64() {
            Some(retries) => u32::try_from(retries).ok(),
            None => {
                let message = format!(
                    "key \"respawn_max_retries\" must be an integer, got {}",
                    describe(value)
                );
                return Err(entity.error(message));
            }
        },
    };
    Ok(ProcessKeys {
        name: entity.template("name")?,
        prefix: entity.template("launch-prefix")?,
        working_directory: entity.template("cwd")?,
        output: entity.template("output")?,
        environment: read_pairs(entity, "env", "name", "value")?,
        respawn: entity.boolean("respawn")?,
        respawn_delay_s: entity.number("respawn_delay")?,
        respawn_max_retries,
        ends_launch,
        sigterm_timeout_s: entity.number("sigterm_timeout")?,
        sigkill_timeout_s: entity.number("sigkill_timeout")?,
    })
}
