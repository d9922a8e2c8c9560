//! A launch file as it is written: ROS 2's YAML launch format, read strictly, nothing resolved yet.

mod read;

use super::{entity::describe, error::LaunchError, substitution::Template};
use read::read_actions;
use serde_yaml_ng::Value;
use std::path::{Path, PathBuf};

/// A launch file: its actions in order.
#[derive(Clone, Debug)]
pub struct LaunchFile {
    /// Where it was read from.
    pub path: PathBuf,
    /// What it says.
    pub actions: Vec<Action>,
}

/// One entry.
#[derive(Clone, Debug)]
pub struct Action {
    /// The entry's name in errors, for example `launch[3] node "encoder"`.
    pub entry: String,
    /// `if:`: do it only where this resolves to true.
    pub only_if: Option<Template>,
    /// `unless:`: do it only where this resolves to false.
    pub unless: Option<Template>,
    /// What to do.
    pub kind: ActionKind,
}

/// What an entry does.
#[derive(Clone, Debug)]
pub enum ActionKind {
    /// `arg`: declares a launch argument.
    Argument(Argument),
    /// `let`: sets a launch variable.
    Let {
        /// The variable.
        name: Template,
        /// Its value.
        value: Template,
    },
    /// `set_env` and, without a value, `unset_env`.
    Environment {
        /// The environment variable.
        name: Template,
        /// Its value; none: it is removed.
        value: Option<Template>,
    },
    /// `push_ros_namespace`: the namespace of the nodes that follow in this group.
    PushNamespace(Template),
    /// `group`.
    Group {
        /// Whether variables, environment and namespace are restored at its end.
        scoped: bool,
        /// Its entries.
        actions: Vec<Action>,
    },
    /// `include`: another YAML launch file.
    Include {
        /// The file.
        file: Template,
        /// Launch arguments for it.
        arguments: Vec<(Template, Template)>,
    },
    /// `node`.
    Node(Box<Node>),
    /// `executable`.
    Executable {
        /// The command line.
        command: Template,
        /// The rest.
        process: ProcessKeys,
    },
}

/// A declared launch argument.
#[derive(Clone, Debug)]
pub struct Argument {
    /// Its name.
    pub name: String,
    /// Its value where the command line gives none; without it the argument is required.
    pub default: Option<Template>,
    /// The default as it is written, for `--show-args`.
    pub default_text: Option<String>,
    /// What it is for.
    pub description: Option<String>,
    /// The values that it may have; empty: any.
    pub choices: Vec<String>,
}

/// A ROS node.
#[derive(Clone, Debug)]
pub struct Node {
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
    /// The rest; its `name` is the node's name.
    pub process: ProcessKeys,
}

/// One `param` of a node.
#[derive(Clone, Debug)]
pub enum Parameter {
    /// `from:` a parameter file.
    File(Template),
    /// `name:` (nested names joined by dots) and `value:`.
    Value {
        /// The name.
        name: Template,
        /// The value.
        value: ParameterValue,
        /// `type`: one of ROS 2's names, such as `float` or `list_of_str`.
        wanted: Option<String>,
    },
}

/// The value of a parameter.
#[derive(Clone, Debug)]
pub enum ParameterValue {
    /// One value.
    One(Scalar),
    /// A list.
    List(Vec<Scalar>),
}

/// A value that is no list.
#[derive(Clone, Debug)]
pub enum Scalar {
    /// A number or a boolean, as YAML gives it.
    Literal(Value),
    /// A text, which may have substitutions in it.
    Text(Template),
}

/// The keys that `node` and `executable` share.
#[derive(Clone, Debug, Default)]
pub struct ProcessKeys {
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
    /// `respawn_max_retries`; none: without end.
    pub respawn_max_retries: Option<u32>,
    /// `on_exit: shutdown`: its end ends the launch.
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
    /// Where the text is not YAML or not a launch file; the entry and key at fault are named.
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

    /// The declared arguments in order, those within groups included.
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
    fn an_unknown_key_names_file_entry_and_key() {
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
    fn a_deep_file_is_an_error_and_not_a_crash() {
        let mut text = "launch: ".to_owned();
        for _ in 0..60 {
            text.push_str("[{group: ");
        }
        text.push_str("[]");
        text.push_str(&"}]".repeat(60));
        assert!(parse(&text).is_err());
    }
}
