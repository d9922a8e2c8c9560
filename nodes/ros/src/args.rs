//! The command line of a node, after its subcommand: `--ros-args` as in every ROS 2 node, `--interface`,
//! `--middleware`, and the rest, which is the node's own.

mod log_level;
mod params_file;

pub use log_level::LogLevels;

use crate::{
    Error, Middleware, ParameterError, ParameterType, names::NodeName, remap::Remap, value::Value,
};
use params_file::Section;
use std::path::{Path, PathBuf};

/// An error of a command line or a parameter file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArgsError {
    /// An unknown flag after `--ros-args`.
    #[error(
        "unknown ROS argument `{0}`; expected -r/--remap, -p/--param, --params-file, --log-level, or -- to end them"
    )]
    Unknown(String),
    /// A flag of ROS that this runtime does not support.
    #[error("`{flag}` is not supported: {reason}")]
    Unsupported {
        /// The flag.
        flag: String,
        /// Why.
        reason: &'static str,
    },
    /// A flag at the end, without its value.
    #[error("`{flag}` needs {expected} after it")]
    Missing {
        /// The flag.
        flag: String,
        /// The missing value.
        expected: &'static str,
    },
    /// A value of the wrong form.
    #[error("`{flag} {value}`: expected {expected}")]
    Malformed {
        /// The flag.
        flag: String,
        /// Its value.
        value: String,
        /// The expected form, and where it helps, the text found.
        expected: String,
    },
    /// A parameter file that cannot be read.
    #[error("cannot read the parameter file {}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's error. Not the `source`, since the message contains it.
        reason: std::io::Error,
    },
    /// An invalid parameter file.
    #[error("parameter file {}: {problem}", path.display())]
    FileContent {
        /// The file.
        path: PathBuf,
        /// The place, the expected form, and the text found.
        problem: String,
    },
    /// Unexpected words.
    #[error("unexpected arguments: {}; ROS arguments go after --ros-args", .0.join(" "))]
    Rest(Vec<String>),
}

/// One `-p` or one parameter of a file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Override {
    /// The nodes that it applies to.
    pub(crate) section: Section,
    /// The parameter's name, nested keys joined by dots.
    pub(crate) name: String,
    /// Its value.
    pub(crate) value: Value,
    /// Its source, for error messages: `-p`, or the file and its section.
    pub(crate) origin: String,
    /// Whether several nodes may share it; a node without the parameter then ignores it.
    pub(crate) is_shared: bool,
}

/// The parsed command line of a node.
#[derive(Clone, Debug, Default)]
pub struct NodeArgs {
    /// `--interface`: the address or the name of the one network interface to use. `None`: the environment variables
    /// decide.
    pub interface: Option<String>,
    /// `--middleware`. `None`: `RMW_IMPLEMENTATION` decides.
    pub middleware: Option<Middleware>,
    pub(crate) remaps: Vec<Remap>,
    pub(crate) overrides: Vec<Override>,
    pub(crate) log_levels: LogLevels,
    pub(crate) rosout: bool,
    rest: Vec<String>,
}

impl NodeArgs {
    /// Parses the words after the subcommand, and reads the parameter files among them.
    ///
    /// # Errors
    /// An unknown ROS argument, a missing or malformed value, an unreadable parameter file.
    pub fn parse<S: Into<String>>(words: impl IntoIterator<Item = S>) -> Result<Self, ArgsError> {
        let mut args = Self {
            rosout: true,
            ..Self::default()
        };
        let mut words = words.into_iter().map(Into::into);
        let mut in_ros_args = false;
        while let Some(word) = words.next() {
            match word.as_str() {
                "--ros-args" => in_ros_args = true,
                "--" if in_ros_args => in_ros_args = false,
                "--interface" => {
                    args.interface =
                        Some(value(&word, "an address or interface name", &mut words)?);
                }
                "--middleware" => {
                    let named = value(&word, Middleware::VALUES, &mut words)?;
                    args.middleware = Some(middleware(&named)?);
                }
                _ if in_ros_args => args.ros_argument(word, &mut words)?,
                _ => match word.split_once('=') {
                    Some(("--interface", interface)) => args.interface = Some(interface.to_owned()),
                    Some(("--middleware", named)) => args.middleware = Some(middleware(named)?),
                    _ => args.rest.push(word),
                },
            }
        }
        Ok(args)
    }

    /// The words outside `--ros-args`, for the node's own command line.
    pub fn rest(&self) -> &[String] {
        &self.rest
    }

    /// The value given for a parameter of a node with these defaults, before the node exists.
    ///
    /// # Errors
    /// The node's name is invalid, or the value has a different type.
    pub fn given<T: ParameterType>(
        &self,
        default_name: &str,
        default_namespace: &str,
        parameter: &str,
    ) -> Result<Option<T>, Error> {
        let node = NodeName::new(default_name, default_namespace, &self.remaps)?.fully_qualified;
        let is_it = |given: &&Override| given.name == parameter && given.section.matches(&node);
        let Some(given) = self.overrides.iter().rfind(is_it) else {
            return Ok(None);
        };
        let wrong = || ParameterError::WrongType {
            node: node.as_str().into(),
            parameter: parameter.into(),
            expected: T::KIND,
            got: given.value.clone(),
            origin: given.origin.as_str().into(),
        };
        Ok(Some(T::from_value(&given.value).ok_or_else(wrong)?))
    }

    /// The absolute name of a topic for a node with these defaults, before the node exists: see
    /// [`Node::resolve`](crate::Node::resolve).
    ///
    /// # Errors
    /// A name that ROS does not allow.
    pub fn resolve(
        &self,
        default_name: &str,
        default_namespace: &str,
        topic: &str,
    ) -> Result<String, Error> {
        NodeName::new(default_name, default_namespace, &self.remaps)?.resolve(topic, "topic")
    }

    /// The absolute name of the sibling `topic/suffix` for a node with these defaults, before the node exists: see
    /// [`Node::resolve_sibling`](crate::Node::resolve_sibling).
    ///
    /// # Errors
    /// A name that ROS does not allow, or a topic that is remapped to a sibling.
    pub fn resolve_sibling(
        &self,
        default_name: &str,
        default_namespace: &str,
        topic: &str,
        suffix: &str,
    ) -> Result<String, Error> {
        NodeName::new(default_name, default_namespace, &self.remaps)?
            .resolve_sibling(topic, suffix, "topic")
    }

    /// For nodes without a command line of their own.
    ///
    /// # Errors
    /// Words outside `--ros-args`.
    pub fn expect_no_rest(&self) -> Result<(), ArgsError> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(ArgsError::Rest(self.rest.clone()))
        }
    }

    /// These arguments for several nodes: parameters without a node's name are shared by all.
    pub(crate) fn of_several(&self) -> Self {
        let mut args = self.clone();
        for given in &mut args.overrides {
            given.is_shared |= given.section == Section::own();
        }
        args
    }

    fn ros_argument(
        &mut self,
        flag: String,
        words: &mut impl Iterator<Item = String>,
    ) -> Result<(), ArgsError> {
        match flag.as_str() {
            "-r" | "--remap" => {
                let rule = value(&flag, "from:=to", words)?;
                self.remaps.push(
                    Remap::parse(&rule).map_err(|expected| malformed(&flag, &rule, expected))?,
                );
            }
            "-p" | "--param" => {
                let assignment = value(&flag, "name:=value", words)?;
                let parsed = parameter(&assignment)
                    .map_err(|expected| malformed(&flag, &assignment, expected))?;
                self.overrides.push(parsed);
            }
            "--params-file" => {
                let path = value(&flag, "a file", words)?;
                self.overrides.extend(params_file::read(Path::new(&path))?);
            }
            "--log-level" => {
                let level = value(&flag, "a level or logger:=level", words)?;
                self.log_levels
                    .add(&level)
                    .map_err(|expected| malformed(&flag, &level, expected))?;
            }
            "--enable-rosout-logs" => self.rosout = true,
            "--disable-rosout-logs" => self.rosout = false,
            // launch files may pass them; they name the defaults of this runtime
            "--enable-stdout-logs"
            | "--enable-external-lib-logs"
            | "--disable-external-lib-logs" => {}
            // without security they have no effect; `environment` warns if security is requested
            "-e" | "--enclave" => {
                value(&flag, "an enclave's name", words)?;
            }
            "--log-config-file" | "--log-file-name" | "--disable-stdout-logs" => {
                return Err(ArgsError::Unsupported {
                    flag,
                    reason: "logs go to stderr and /rosout",
                });
            }
            _ => return Err(ArgsError::Unknown(flag)),
        }
        Ok(())
    }
}

fn value(
    flag: &str,
    expected: &'static str,
    words: &mut impl Iterator<Item = String>,
) -> Result<String, ArgsError> {
    words.next().ok_or_else(|| ArgsError::Missing {
        flag: flag.to_owned(),
        expected,
    })
}

fn middleware(name: &str) -> Result<Middleware, ArgsError> {
    Middleware::parse(name)
        .ok_or_else(|| malformed("--middleware", name, Middleware::VALUES.to_owned()))
}

fn malformed(flag: &str, value: &str, expected: String) -> ArgsError {
    ArgsError::Malformed {
        flag: flag.to_owned(),
        value: value.to_owned(),
        expected,
    }
}

/// `name:=value` or `node:name:=value`, the value in YAML.
fn parameter(assignment: &str) -> Result<Override, String> {
    let Some((target, text)) = assignment.split_once(":=") else {
        return Err("name:=value".to_owned());
    };
    let (section, name) = match target.split_once(':') {
        Some((node, name)) => (Section::parse(node)?, name),
        None => (Section::own(), target),
    };
    if name.is_empty() {
        return Err("a parameter name before :=".to_owned());
    }
    let value = if text.is_empty() {
        Value::String(String::new())
    } else {
        let yaml =
            serde_yaml_ng::from_str(text).map_err(|error| format!("a YAML value; {error}"))?;
        Value::from_yaml(&yaml)?
    };
    Ok(Override {
        section,
        name: name.to_owned(),
        value,
        origin: format!("-p {assignment}"),
        is_shared: false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(line: &str) -> Result<NodeArgs, ArgsError> {
        NodeArgs::parse(line.split_whitespace())
    }

    #[test]
    fn ros_arguments_end_at_the_dashes_and_may_come_twice() {
        let args =
            parse("bag --ros-args -p a:=1 -- --rate 2 --ros-args -r x:=y --interface lo").unwrap();
        assert_eq!(args.rest(), ["bag", "--rate", "2"]);
        assert_eq!(args.overrides.len(), 1);
        assert_eq!(args.remaps.len(), 1);
        assert_eq!(args.interface.as_deref(), Some("lo"));
        assert!(matches!(args.expect_no_rest(), Err(ArgsError::Rest(words)) if words.len() == 3));
    }

    #[test]
    fn parameters_are_typed_as_yaml() {
        let value = |text: &str| {
            parse(&format!("--ros-args -p {text}")).map(|mut args| args.overrides.remove(0).value)
        };
        assert_eq!(value("a:=1").unwrap(), Value::Integer(1));
        assert_eq!(value("a:=1.5").unwrap(), Value::Double(1.5));
        assert_eq!(value("a:=[1,2]").unwrap(), Value::IntegerArray(vec![1, 2]));
        assert_eq!(value("a:=").unwrap(), Value::String(String::new()));
        assert_eq!(
            value("a:=/dev/video0").unwrap(),
            Value::String("/dev/video0".into())
        );
    }

    #[test]
    fn a_value_is_known_before_there_is_a_node() {
        let line =
            "--ros-args -r __node:=second -p bag:=a -p second:bag:=b -p player:bag:=c -p n:=1";
        let args = parse(line).unwrap();
        let given = |name: &str| args.given::<String>("player", "/wm", name);
        assert_eq!(given("bag").unwrap().as_deref(), Some("b"));
        assert_eq!(given("other").unwrap(), None);
        let error = given("n").unwrap_err().to_string();
        assert!(
            error.contains("expects") && error.contains("-p n:=1"),
            "{error}"
        );
    }

    #[test]
    fn faults_are_named() {
        let message = |line: &str| parse(line).unwrap_err().to_string();
        assert!(message("--ros-args --frobnicate").contains("unknown ROS argument `--frobnicate`"));
        assert!(message("--ros-args -p").contains("`-p` needs name:=value"));
        assert!(message("--ros-args -p rate=2").contains("`-p rate=2`: expected name:=value"));
        assert!(message("--ros-args -p a:={b:1}").contains("expected"));
        assert!(message("--ros-args --params-file /no/such.yaml").contains("/no/such.yaml"));
        assert!(message("--ros-args --log-level loud").contains("loud"));
        assert!(message("--ros-args --enclave").contains("`--enclave` needs"));
        assert!(parse("--ros-args --enclave /a").is_ok());
        assert!(message("--ros-args -r :=b").contains("`-r :=b`"));
    }

    proptest! {
        /// Any words give arguments or an error; words outside `--ros-args` are kept.
        #[test]
        fn any_words_are_answered(words in prop::collection::vec("(-r|-p|--|--ros-args|[a-z_:=/~\\[{]{0,8})", 0..8)) {
            if let Ok(args) = NodeArgs::parse(words.clone()) && !words.iter().any(|word| word == "--ros-args") {
                prop_assert_eq!(args.rest(), words);
            }
        }
    }
}
