//! A process of a plan, made from a `node` or `executable`.

use super::Site;
use crate::{
    entity::describe,
    error::LaunchError,
    file::{Node, Parameter, ParameterValue, ProcessKeys, Scalar},
    substitution::Template,
};
use serde_yaml_ng::Value;
use std::path::PathBuf;
use std::time::Duration;

/// The package whose executables are subcommands of this program.
const OWN_PACKAGE: &str = "wm_nodes";
/// The executable that is this program itself, with its own arguments.
const OWN_PROGRAM: &str = "wm";

/// ROS 2's default for both steps of a stop.
const STOP_TIMEOUT: Duration = Duration::from_secs(5);

/// The program of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Program {
    /// This program, with the node's name as first argument.
    Own,
    /// A path, or a name in `PATH`.
    Path(PathBuf),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// Both streams to the screen.
    Screen,
    /// Only standard error to the screen: ROS 2's default, which writes standard output to a log file; this launcher
    /// has none.
    Log,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Respawn {
    /// Time from its end to its next start.
    pub delay: Duration,
    /// `None`: unlimited.
    pub max_retries: Option<u32>,
}

/// A process of a launch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Process {
    /// Its name in logs and errors: the name of the node or executable, and a number.
    pub name: String,
    /// The full name of the ROS node, if given.
    pub node: Option<String>,
    /// A command that runs the program with its arguments; may be empty.
    pub prefix: Vec<String>,
    /// The program, without its arguments.
    pub program: Program,
    /// The arguments of `program`.
    pub arguments: Vec<String>,
    /// Changes to the environment; `None` removes.
    pub environment: Vec<(String, Option<String>)>,
    /// `None`: the launcher's.
    pub working_directory: Option<PathBuf>,
    /// The streams on the screen.
    pub output: Output,
    /// `None`: it is not restarted.
    pub respawn: Option<Respawn>,
    /// Whether its end ends the launch.
    pub ends_launch: bool,
    /// Whether it serves the others: it starts first, and ends once they have ended.
    pub is_service: bool,
    /// From SIGINT to SIGTERM.
    pub sigterm_timeout: Duration,
    /// From SIGTERM to SIGKILL.
    pub sigkill_timeout: Duration,
}

pub(super) fn node(node: &Node, site: &Site<'_>, index: usize) -> Result<Process, LaunchError> {
    let package = site.resolve("pkg", &node.package)?;
    let executable = site.resolve("exec", &node.executable)?;
    let name = site.resolve_optional("name", node.process.name.as_ref())?;
    let namespace = site.resolve_optional("namespace", node.namespace.as_ref())?;
    let namespace = join_namespaces(site.scope.namespace.as_deref(), namespace.as_deref());

    let mut arguments = Vec::new();
    let program = if package == OWN_PACKAGE {
        if executable != OWN_PROGRAM {
            arguments.push(executable.clone());
        }
        Program::Own
    } else {
        Program::Path(find_executable(&package, &executable, site)?)
    };
    if let Some(template) = &node.arguments {
        arguments.extend(site.words("args", template)?);
    }
    arguments.push("--ros-args".to_owned());
    if let Some(template) = &node.ros_arguments {
        arguments.extend(site.words("ros_args", template)?);
    }
    if let Some(name) = &name {
        arguments.extend(["-r".to_owned(), format!("__node:={name}")]);
    }
    if let Some(namespace) = &namespace {
        arguments.extend(["-r".to_owned(), format!("__ns:={namespace}")]);
    }
    for parameter in &node.parameters {
        arguments.extend(parameter_arguments(parameter, site)?);
    }
    for (from, to) in &node.remaps {
        let (from, to) = (site.resolve("remap", from)?, site.resolve("remap", to)?);
        arguments.extend(["-r".to_owned(), format!("{from}:={to}")]);
    }
    let label = name.clone().unwrap_or(executable);
    let mut process = with_keys(&node.process, site, &label, index)?;
    process.node = name.map(|name| format!("{}/{name}", namespace.as_deref().unwrap_or_default()));
    process.program = program;
    process.arguments = arguments;
    Ok(process)
}

pub(super) fn executable(
    command: &Template,
    keys: &ProcessKeys,
    site: &Site<'_>,
    index: usize,
) -> Result<Process, LaunchError> {
    let mut words = site.words("cmd", command)?.into_iter();
    let Some(program) = words.next() else {
        return Err(site.error("key \"cmd\" is empty".to_owned()));
    };
    let program = PathBuf::from(program);
    let label = match site.resolve_optional("name", keys.name.as_ref())? {
        Some(name) => name,
        None => program
            .file_name()
            .map(|name| name.to_string_lossy().into_owned())
            .unwrap_or_default(),
    };
    let mut process = with_keys(keys, site, &label, index)?;
    process.program = Program::Path(program);
    process.arguments = words.collect();
    Ok(process)
}

/// Joins the namespaces of the group and the node. An absolute namespace of the node replaces the group's.
pub(super) fn join_namespaces(outer: Option<&str>, inner: Option<&str>) -> Option<String> {
    let joined = match (outer, inner) {
        (_, Some(inner)) if inner.starts_with('/') => inner.to_owned(),
        (Some(outer), Some(inner)) => format!("{outer}/{inner}"),
        (Some(only), None) | (None, Some(only)) => only.to_owned(),
        (None, None) => return None,
    };
    let parts: Vec<&str> = joined.split('/').filter(|part| !part.is_empty()).collect();
    Some(format!("/{}", parts.join("/")))
}

fn with_keys(
    keys: &ProcessKeys,
    site: &Site<'_>,
    label: &str,
    index: usize,
) -> Result<Process, LaunchError> {
    let output = match site
        .resolve_optional("output", keys.output.as_ref())?
        .as_deref()
    {
        None | Some("log") => Output::Log,
        Some("screen" | "both") => Output::Screen,
        Some(other) => {
            return Err(site.error(format!(
                "key \"output\" must be screen, log or both, got {other:?}"
            )));
        }
    };
    let is_respawned = match &keys.respawn {
        Some(template) => site.boolean("respawn", template)?,
        None => false,
    };
    let mut environment: Vec<(String, Option<String>)> = site
        .scope
        .environment
        .iter()
        .map(|(name, value)| (name.clone(), value.clone()))
        .collect();
    for (name, value) in &keys.environment {
        environment.push((
            site.resolve("env", name)?,
            Some(site.resolve("env", value)?),
        ));
    }
    Ok(Process {
        name: format!("{label}-{}", index + 1),
        node: None,
        prefix: match &keys.prefix {
            // as in ROS 2, unlike `args`: a variable may contain a whole prefix, or nothing
            Some(template) => {
                let text = site.resolve("launch-prefix", template)?;
                site.words("launch-prefix", &Template::plain(text))?
            }
            None => Vec::new(),
        },
        program: Program::Own,
        arguments: Vec::new(),
        environment,
        working_directory: site
            .resolve_optional("cwd", keys.working_directory.as_ref())?
            .map(PathBuf::from),
        output,
        respawn: is_respawned.then(|| Respawn {
            delay: keys.respawn_delay_s.map_or(Duration::ZERO, seconds),
            max_retries: keys.respawn_max_retries,
        }),
        ends_launch: keys.ends_launch,
        is_service: false,
        sigterm_timeout: keys.sigterm_timeout_s.map_or(STOP_TIMEOUT, seconds),
        sigkill_timeout: keys.sigkill_timeout_s.map_or(STOP_TIMEOUT, seconds),
    })
}

/// Converts seconds that are finite and not negative; at most a day, so that timers do not overflow.
fn seconds(value: f64) -> Duration {
    Duration::from_secs_f64(value.min(86_400.0))
}

fn find_executable(
    package: &str,
    executable: &str,
    site: &Site<'_>,
) -> Result<PathBuf, LaunchError> {
    let Some(prefix) = site.surroundings.package_prefix(package) else {
        return Err(site.error(format!(
            "package {package:?} was not found in AMENT_PREFIX_PATH (is its ROS workspace sourced?)"
        )));
    };
    let path = prefix.join("lib").join(package).join(executable);
    if site.surroundings.exists(&path) {
        Ok(path)
    } else {
        Err(site.error(format!(
            "package {package:?} has no executable {executable:?}: {} is missing",
            path.display()
        )))
    }
}

fn parameter_arguments(parameter: &Parameter, site: &Site<'_>) -> Result<[String; 2], LaunchError> {
    match parameter {
        Parameter::File(template) => {
            let path = site.resolve("param", template)?;
            if !site.surroundings.exists(&PathBuf::from(&path)) {
                return Err(site.error(format!("parameter file {path:?} does not exist")));
            }
            Ok(["--params-file".to_owned(), path])
        }
        Parameter::Value {
            name,
            value,
            wanted,
        } => {
            let name = site.resolve("param", name)?;
            let typed = |scalar: &Scalar, wanted: Option<&str>| -> Result<Value, LaunchError> {
                let value = resolve_scalar(&name, scalar, wanted, site)?;
                check_type(value, wanted).map_err(|(wanted, value)| {
                    site.error(format!(
                        "parameter {name:?} must be of type {wanted}, got {}",
                        describe(&value)
                    ))
                })
            };
            let wanted = wanted.as_deref();
            let item_type = wanted.and_then(|wanted| wanted.strip_prefix("list_of_"));
            let value = match (value, item_type, wanted) {
                (ParameterValue::List(items), Some(_), _)
                | (ParameterValue::List(items), _, None) => {
                    let items = items.iter().map(|item| typed(item, item_type));
                    Value::Sequence(items.collect::<Result<_, _>>()?)
                }
                (ParameterValue::One(scalar), None, _) => typed(scalar, wanted)?,
                (ParameterValue::List(_), None, Some(wanted)) => {
                    return Err(site.error(format!(
                        "parameter {name:?} must be of type {wanted}, got a list"
                    )));
                }
                (ParameterValue::One(_), Some(_), _) => {
                    return Err(site.error(format!(
                        "parameter {name:?} must be of type {}, got a single value",
                        wanted.unwrap_or_default()
                    )));
                }
            };
            let value = flow_yaml(&value).ok_or_else(|| {
                site.error(format!(
                    "parameter {name:?} has a value that is not a ROS parameter value"
                ))
            })?;
            Ok(["-p".to_owned(), format!("{name}:={value}")])
        }
    }
}

/// Resolves a scalar. Without a type, a text without substitutions stays a text.
fn resolve_scalar(
    name: &str,
    scalar: &Scalar,
    wanted: Option<&str>,
    site: &Site<'_>,
) -> Result<Value, LaunchError> {
    match scalar {
        Scalar::Literal(value) => Ok(value.clone()),
        Scalar::Text(template) => {
            let text = site.resolve(&format!("param {name}"), template)?;
            let is_text = wanted.map_or(template.is_plain(), |wanted| wanted == "str");
            Ok(match (is_text, wanted) {
                (true, _) => Value::String(text),
                // if a float is expected, the text "2" is a number; the literal 2 is not, as in ROS 2's frontend
                (false, Some("float")) => match text.trim().parse::<f64>() {
                    Ok(number) => Value::Number(number.into()),
                    Err(_) => Value::String(text),
                },
                _ => read_text(text),
            })
        }
    }
}

/// The value if it has the expected type; otherwise the type's name and the value.
fn check_type(value: Value, wanted: Option<&str>) -> Result<Value, (String, Value)> {
    let fits = match (wanted, &value) {
        (Some("str"), value) => value.is_string(),
        (Some("bool"), value) => value.is_bool(),
        (Some("int"), value) => value.is_i64(),
        (Some("float"), value) => value.is_f64(),
        _ => true,
    };
    match wanted {
        Some(wanted) if !fits => Err((wanted.to_owned(), value)),
        _ => Ok(value),
    }
}

/// The YAML value of a resolved text if it is a scalar or a list; otherwise the text.
fn read_text(text: String) -> Value {
    match serde_yaml_ng::from_str(&text) {
        Ok(value @ (Value::Bool(_) | Value::Number(_) | Value::Sequence(_))) => value,
        _ => Value::String(text),
    }
}

/// A scalar or a list of scalars as one line of YAML. JSON strings are valid YAML.
fn flow_yaml(value: &Value) -> Option<String> {
    match value {
        Value::Bool(value) => Some(value.to_string()),
        // YAML must recognise 1.0 as a float; this prints 1.0
        Value::Number(number) => Some(number.to_string()),
        Value::String(text) => serde_json::to_string(text).ok(),
        Value::Sequence(items) => {
            let items = items.iter().map(flow_yaml).collect::<Option<Vec<_>>>()?;
            Some(format!("[{}]", items.join(", ")))
        }
        Value::Null | Value::Mapping(_) | Value::Tagged(_) => None,
    }
}
