//! The contents of a launch file: ROS 2's YAML launch format, read strictly, not yet resolved.

mod read;

use super::{entity::describe, error::LaunchError, substitution::Template};
use read::read_actions;
use serde_yaml_ng::Value;
use std::path::{Path, PathBuf};

/// A launch file: its actions in order.
#[derive(Clone, Debug)]
pub struct LaunchFile {
    pub(crate) path: PathBuf,
    pub(crate) actions: Vec<Action>,
}

/// One entry.
#[derive(Clone, Debug)]
pub(crate) struct Action {
    /// The entry's name in errors, for example `launch[3] node "encoder"`.
    pub entry: String,
    /// `if:` execute only if this resolves to true.
    pub only_if: Option<Template>,
    /// `unless:` execute only if this resolves to false.
    pub unless: Option<Template>,
    pub kind: ActionKind,
}

#[derive(Clone, Debug)]
pub(crate) enum ActionKind {
    /// `arg`: declares a launch argument.
    Argument(Argument),
    /// `let`: sets a launch variable.
    Let { name: Template, value: Template },
    /// `set_env` and, without a value, `unset_env`.
    Environment {
        name: Template,
        /// `None` removes it.
        value: Option<Template>,
    },
    /// `push_ros_namespace`: the namespace of the following nodes in this group.
    PushNamespace(Template),
    /// `group`.
    Group {
        /// Whether its end restores variables, environment and namespace.
        scoped: bool,
        actions: Vec<Action>,
    },
    /// `include`: another YAML launch file.
    Include {
        file: Template,
        arguments: Vec<(Template, Template)>,
    },
    /// `node`.
    Node(Box<Node>),
    /// `executable`.
    Executable {
        /// The command line.
        command: Template,
        process: ProcessKeys,
    },
}

#[derive(Clone, Debug)]
pub struct Argument {
    pub name: String,
    /// The value if the command line gives none; without it the argument is required.
    pub default: Option<Template>,
    /// The default as written, for `--show-args`.
    pub default_text: Option<String>,
    pub description: Option<String>,
    /// The allowed values; if empty, any.
    pub choices: Vec<String>,
}

#[derive(Clone, Debug)]
pub(crate) struct Node {
    /// `pkg`.
    pub package: Template,
    /// `exec`.
    pub executable: Template,
    /// `namespace`.
    pub namespace: Option<Template>,
    /// `args`: plain arguments.
    pub arguments: Option<Template>,
    /// `ros_args`: arguments after `--ros-args`.
    pub ros_arguments: Option<Template>,
    /// `remap`: from, to.
    pub remaps: Vec<(Template, Template)>,
    /// `param`.
    pub parameters: Vec<Parameter>,
    /// Its `name` is the node's name.
    pub process: ProcessKeys,
}

/// One `param` of a node.
#[derive(Clone, Debug)]
pub(crate) enum Parameter {
    /// `from:` a parameter file.
    File(Template),
    /// `name:` (nested names joined by dots) and `value:`.
    Value {
        name: Template,
        value: ParameterValue,
        /// `type`: one of ROS 2's names, such as `float` or `list_of_str`.
        wanted: Option<String>,
    },
}

/// The value of a parameter.
#[derive(Clone, Debug)]
pub(crate) enum ParameterValue {
    One(Scalar),
    List(Vec<Scalar>),
}

/// A value that is not a list.
#[derive(Clone, Debug)]
pub(crate) enum Scalar {
    /// A number or a boolean.
    Literal(Value),
    /// A text, perhaps with substitutions.
    Text(Template),
}

/// The keys that `node` and `executable` share.
#[derive(Clone, Debug, Default)]
pub(crate) struct ProcessKeys {
    /// `name`.
    pub name: Option<Template>,
    /// `launch-prefix`: words before the command line, such as `nice -n 10`.
    pub prefix: Option<Template>,
    /// `cwd`.
    pub working_directory: Option<Template>,
    /// `output`: `screen`, `log` or `both`.
    pub output: Option<Template>,
    /// `env`.
    pub environment: Vec<(Template, Template)>,
    /// `respawn`.
    pub respawn: Option<Template>,
    /// `respawn_delay` \[s\].
    pub respawn_delay_s: Option<f64>,
    /// `respawn_max_retries`; `None`: unlimited.
    pub respawn_max_retries: Option<u32>,
    /// `on_exit: shutdown`: the end of the process ends the launch.
    pub ends_launch: bool,
    /// `sigterm_timeout` \[s\]: from SIGINT to SIGTERM.
    pub sigterm_timeout_s: Option<f64>,
    /// `sigkill_timeout` \[s\]: from SIGTERM to SIGKILL.
    pub sigkill_timeout_s: Option<f64>,
}

impl LaunchFile {
    /// Reads the text of the launch file `path`.
    ///
    /// # Errors
    /// The text is not YAML or not a launch file. Names the entry and key at fault.
    pub fn parse(path: &Path, text: &str) -> Result<Self, LaunchError> {
        let document: Value =
            serde_yaml_ng::from_str(text).map_err(|source| LaunchError::Yaml {
                file: path.to_owned(),
                source,
            })?;
        let root = |message| LaunchError::Entry {
            file: path.to_owned(),
            entry: "the file".to_owned(),
            message,
        };
        let Value::Mapping(mapping) = &document else {
            return Err(root(format!(
                "expected a mapping with the one key \"launch\", got {}",
                describe(&document)
            )));
        };
        let entries = match mapping.get("launch") {
            Some(entries) if mapping.len() == 1 => entries,
            _ => {
                return Err(root(
                    "expected the one key \"launch\" at the top".to_owned(),
                ));
            }
        };
        Ok(Self {
            path: path.to_owned(),
            actions: read_actions(path, "launch", entries, 0)?,
        })
    }

    /// The declared arguments in order, including those within groups.
    #[must_use]
    pub fn arguments(&self) -> Vec<&Argument> {
        fn collect<'a>(actions: &'a [Action], arguments: &mut Vec<&'a Argument>) {
            for action in actions {
                match &action.kind {
                    ActionKind::Argument(argument) => arguments.push(argument),
                    ActionKind::Group { actions, .. } => collect(actions, arguments),
                    _ => {}
                }
            }
        }
        let mut arguments = Vec::new();
        collect(&self.actions, &mut arguments);
        arguments
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<LaunchFile, LaunchError> {
        LaunchFile::parse(Path::new("x.launch.yaml"), text)
    }

    fn message(text: &str) -> String {
        parse(text).unwrap_err().to_string()
    }

    #[test]
    fn error_for_unknown_key_names_file_entry_and_key() {
        let text = "launch:\n- arg: {name: a}\n- node: {pkg: p, exec: encoder, respwan: true}\n";
        let message = message(text);
        assert!(message.contains("x.launch.yaml"), "{message}");
        assert!(message.contains("launch[1] node \"encoder\""), "{message}");
        assert!(message.contains("\"respwan\""), "{message}");
        assert!(message.contains("respawn"), "{message}");
    }

    #[test]
    fn malformed_entries_are_named() {
        assert!(message("a: 1").contains("one key \"launch\""));
        assert!(message("launch: 3").contains("list of actions"));
        assert!(message("launch:\n- nod: {}").contains("unknown action \"nod\""));
        assert!(message("launch:\n- node: {pkg: p}").contains("\"exec\" is missing"));
        assert!(message("launch:\n- arg: {name: a, default: 1.0}").contains("must be a string"));
        assert!(
            message("launch:\n- node: {pkg: p, exec: e, on_exit: restart}").contains("\"on_exit\"")
        );
        assert!(
            message("launch:\n- node: {pkg: p, exec: e, param: [{value: 1}]}").contains("param[0]")
        );
        assert!(message("launch:\n- node: {pkg: p, exec: '$(var x'}").contains("key \"exec\""));
        assert!(message("launch:\n- group: {scoped: yes please, children: []}").contains("scoped"));
        assert!(message("launch: [").contains("not YAML"));
    }

    #[test]
    fn nested_parameters_join_with_dots() {
        let text =
            "launch:\n- node: {pkg: p, exec: e, param: [{name: a, param: [{name: b, value: 2}]}]}";
        let file = parse(text).unwrap();
        let ActionKind::Node(node) = &file.actions[0].kind else {
            panic!("not a node")
        };
        let Parameter::Value {
            name,
            value: ParameterValue::One(Scalar::Literal(value)),
            ..
        } = &node.parameters[0]
        else {
            panic!("not a literal")
        };
        assert_eq!(name, &Template::plain("a.b".to_owned()));
        assert_eq!(value.as_i64(), Some(2));
    }

    #[test]
    fn deep_nesting_is_an_error() {
        let mut text = "launch: ".to_owned();
        for _ in 0..60 {
            text.push_str("[{group: ");
        }
        text.push_str("[]");
        text.push_str(&"}]".repeat(60));
        assert!(parse(&text).is_err());
    }
}
