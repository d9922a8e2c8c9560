//! Commands of clients.

use crate::picture::{Label, Source};
use serde_json::{Map, Value};
use std::fmt;
use thiserror::Error;

/// What the page may do besides showing data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Permission {
    /// Only stop the executor, which only reduces motion.
    Nothing,
    /// Also set goals, choose candidates and reset the nodes' histories. If the executor is armed, this may move the
    /// arm.
    Goals,
    /// Also arm the executor.
    All,
}

impl Permission {
    /// As sent to the page.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Nothing => "none",
            Self::Goals => "goals",
            Self::All => "all",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Command {
    /// Clears the histories of predictor, planner and evaluator.
    Reset,
    /// A shown picture becomes the goal.
    Goal(Label),
    /// A candidate becomes the policy's next action chunk.
    Choose { stamp: i64, index: usize },
    /// Arms or disarms the executor.
    Arm { armed: bool },
    /// Emergency stop of the executor.
    Stop,
    /// Ends the emergency stop; the executor stays disarmed.
    Release,
}

const OPERATIONS: &str = "reset, goal, choose, arm, stop or release";
/// JavaScript's numbers do not hold times.
const STAMP: &str = "a time in ns as a text, such as \"1732000000123456789\"";
/// The most characters of a client's value that a reply repeats.
const LONGEST_QUOTE: usize = 40;

/// Why a message is not a command. Each text names the operation and the field, the expected and the found value.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub(crate) enum CommandError {
    /// Not JSON, or of another shape.
    #[error("not a command: {0}; expected {{\"number\":1,\"command\":{{\"op\":\"stop\"}}}}")]
    Shape(String),
    #[error("the command has no \"op\"; expected {OPERATIONS}")]
    NoOperation,
    #[error("the command's \"op\" is {0}; expected {OPERATIONS}")]
    Operation(String),
    #[error("op \"{op}\": the field \"{field}\" is missing; expected {expected}")]
    Missing {
        op: &'static str,
        field: &'static str,
        expected: &'static str,
    },
    /// A field has an invalid value.
    #[error("op \"{op}\": the field \"{field}\" is {came}; expected {expected}")]
    Value {
        op: &'static str,
        field: &'static str,
        came: String,
        expected: &'static str,
    },
    /// The operation has no such field; it might change the meaning.
    #[error("op \"{op}\" has no field {field}")]
    Field { op: &'static str, field: String },
}

/// A client's value as replies repeat it.
fn quoted(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(LONGEST_QUOTE) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

/// The fields of a command that were not read yet.
struct Fields {
    op: &'static str,
    left: Map<String, Value>,
}

impl Fields {
    /// Reads a field; `read` returns `None` for unexpected values.
    fn take<T>(
        &mut self,
        field: &'static str,
        expected: &'static str,
        read: impl FnOnce(&Value) -> Option<T>,
    ) -> Result<T, CommandError> {
        let op = self.op;
        let value = self.left.remove(field).ok_or(CommandError::Missing {
            op,
            field,
            expected,
        })?;
        read(&value).ok_or_else(|| CommandError::Value {
            op,
            field,
            came: quoted(&value),
            expected,
        })
    }

    fn stamp(&mut self, field: &'static str) -> Result<i64, CommandError> {
        self.take(field, STAMP, |value| value.as_str()?.parse().ok())
    }

    fn nothing_else(self) -> Result<(), CommandError> {
        match self.left.keys().next() {
            None => Ok(()),
            Some(field) => Err(CommandError::Field {
                op: self.op,
                field: quoted(&Value::from(field.as_str())),
            }),
        }
    }
}

/// For the log.
impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reset => f.write_str("reset the histories of predictor, planner and evaluator"),
            Self::Goal(label) => write!(
                f,
                "set as goal the picture {} of {} ns",
                label.source.name(),
                label.stamp_ns
            ),
            Self::Choose { stamp, index } => write!(f, "pick candidate {index} of {stamp} ns"),
            Self::Arm { armed: true } => f.write_str("arm the executor"),
            Self::Arm { armed: false } => f.write_str("disarm the executor"),
            Self::Stop => f.write_str("stop the executor"),
            Self::Release => f.write_str("release the stop of the executor"),
        }
    }
}

impl Command {
    /// The required permission.
    pub(crate) const fn needs(&self) -> Permission {
        match self {
            Self::Stop | Self::Arm { armed: false } => Permission::Nothing,
            Self::Reset | Self::Goal(_) | Self::Choose { .. } => Permission::Goals,
            Self::Arm { armed: true } | Self::Release => Permission::All,
        }
    }

    fn parse(command: Value) -> Result<Self, CommandError> {
        let Value::Object(mut left) = command else {
            let came = quoted(&command);
            return Err(CommandError::Shape(format!("\"command\" is {came}")));
        };
        let named = left.remove("op").ok_or(CommandError::NoOperation)?;
        let names = ["reset", "goal", "choose", "arm", "stop", "release"];
        let op = names.into_iter().find(|name| named == **name);
        let op = op.ok_or_else(|| CommandError::Operation(quoted(&named)))?;
        let mut fields = Fields { op, left };
        let command = match op {
            "reset" => Self::Reset,
            "goal" => Self::Goal(Label {
                source: fields.take(
                    "source",
                    "camera, predicted, plan, candidates or goal",
                    |value| Source::named(value.as_str()?),
                )?,
                stamp_ns: fields.stamp("stamp")?,
                observed_ns: fields.stamp("observed")?,
                step: fields.take("k", "an integer from 0 to 255", |value| {
                    value.as_u64()?.try_into().ok()
                })?,
            }),
            "choose" => Self::Choose {
                stamp: fields.stamp("stamp")?,
                index: fields.take("index", "an integer from 0", |value| {
                    value.as_u64()?.try_into().ok()
                })?,
            },
            "arm" => Self::Arm {
                armed: fields.take("armed", "true or false", Value::as_bool)?,
            },
            "stop" => Self::Stop,
            _ => Self::Release,
        };
        fields.nothing_else()?;
        Ok(command)
    }
}

/// A command with the number of its reply.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Numbered {
    pub number: u32,
    pub command: Command,
}

impl Numbered {
    /// Parses a client's message.
    ///
    /// # Errors
    /// The fault, and the number if there is one.
    pub(crate) fn parse(text: &str) -> Result<Self, (Option<u32>, CommandError)> {
        let shape = |reason: String| (None, CommandError::Shape(reason));
        let message = serde_json::from_str(text).map_err(|error| shape(error.to_string()))?;
        let Value::Object(mut message) = message else {
            return Err(shape(format!("it is {}", quoted(&message))));
        };
        let number = match message.remove("number") {
            None => return Err(shape("\"number\" is missing".to_owned())),
            Some(number) => number
                .as_u64()
                .and_then(|number| u32::try_from(number).ok())
                .ok_or_else(|| shape(format!("\"number\" is {}", quoted(&number))))?,
        };
        let numbered = |malformed| (Some(number), malformed);
        let missing = || numbered(CommandError::Shape("\"command\" is missing".to_owned()));
        let command = message.remove("command").ok_or_else(missing)?;
        if let Some(field) = message.keys().next() {
            let field = quoted(&Value::from(field.as_str()));
            let reason = format!("{field} is no part of it");
            return Err(numbered(CommandError::Shape(reason)));
        }
        let command = Command::parse(command).map_err(numbered)?;
        Ok(Self { number, command })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(command: &str) -> Result<Numbered, (Option<u32>, CommandError)> {
        Numbered::parse(&format!("{{\"number\":7,\"command\":{command}}}"))
    }

    #[test]
    fn commands_are_parsed_with_their_permission() {
        let expected = [
            (r#"{"op":"stop"}"#, Permission::Nothing),
            (r#"{"op":"arm","armed":false}"#, Permission::Nothing),
            (r#"{"op":"reset"}"#, Permission::Goals),
            (
                r#"{"op":"goal","source":"camera","stamp":"1732000000123456789","observed":"-3","k":0}"#,
                Permission::Goals,
            ),
            (
                r#"{"op":"choose","stamp":"5","index":2}"#,
                Permission::Goals,
            ),
            (r#"{"op":"arm","armed":true}"#, Permission::All),
            (r#"{"op":"release"}"#, Permission::All),
        ];
        for (text, needs) in expected {
            let numbered = read(text).unwrap();
            assert_eq!(
                (numbered.number, numbered.command.needs()),
                (7, needs),
                "{text}"
            );
        }
    }

    #[test]
    fn command_errors_name_operation_and_field() {
        let cases = [
            (
                r#"{"op":"arm"}"#,
                r#"op "arm": the field "armed" is missing; expected true or false"#,
            ),
            (
                r#"{"op":"arm","armed":"yes"}"#,
                r#"op "arm": the field "armed" is "yes"; expected true or false"#,
            ),
            (
                r#"{"op":"stop","now":true}"#,
                r#"op "stop" has no field "now""#,
            ),
            (
                r#"{"op":"reset","armed":1}"#,
                r#"op "reset" has no field "armed""#,
            ),
            (
                r#"{"op":"release","":0}"#,
                r#"op "release" has no field """#,
            ),
            (
                r#"{"op":"goal","source":"sky","stamp":"1","observed":"1","k":0}"#,
                r#"op "goal": the field "source" is "sky"; expected camera, predicted, plan, candidates or goal"#,
            ),
            (
                r#"{"op":"goal","source":"camera","stamp":17,"observed":"1","k":0}"#,
                r#"op "goal": the field "stamp" is 17; expected a time in ns as a text, such as "1732000000123456789""#,
            ),
            (
                r#"{"op":"goal","source":"camera","stamp":"17","k":0}"#,
                r#"op "goal": the field "observed" is missing; expected a time in ns as a text, such as "1732000000123456789""#,
            ),
            (
                r#"{"op":"goal","source":"camera","stamp":"17","observed":"1","k":256}"#,
                r#"op "goal": the field "k" is 256; expected an integer from 0 to 255"#,
            ),
            (
                r#"{"op":"choose","stamp":"5"}"#,
                r#"op "choose": the field "index" is missing; expected an integer from 0"#,
            ),
            (
                r#"{"op":"choose","stamp":"5","index":-1}"#,
                r#"op "choose": the field "index" is -1; expected an integer from 0"#,
            ),
            (
                r#"{"op":"launch"}"#,
                r#"the command's "op" is "launch"; expected reset, goal, choose, arm, stop or release"#,
            ),
            (
                r#"{"armed":true}"#,
                r#"the command has no "op"; expected reset, goal, choose, arm, stop or release"#,
            ),
            (
                r#""stop""#,
                r#"not a command: "command" is "stop"; expected {"number":1,"command":{"op":"stop"}}"#,
            ),
        ];
        for (text, expected) in cases {
            let error = read(text).unwrap_err();
            assert_eq!((error.0, error.1.to_string().as_str()), (Some(7), expected));
        }
    }

    #[test]
    fn malformed_messages_are_answered_without_a_number() {
        let cases = [
            ("[]", "it is []"),
            ("{}", "\"number\" is missing"),
            ("stop", "expected value at line 1 column 1"),
            (r#"{"number":-1,"command":{}}"#, "\"number\" is -1"),
        ];
        for (text, reason) in cases {
            let (number, malformed) = Numbered::parse(text).unwrap_err();
            assert_eq!(
                (number, malformed),
                (None, CommandError::Shape(reason.to_owned()))
            );
        }
        let (number, malformed) = Numbered::parse(r#"{"number":7}"#).unwrap_err();
        assert!(number == Some(7) && malformed.to_string().contains("\"command\" is missing"));
        let more = r#"{"number":7,"command":{"op":"stop"},"token":"x"}"#;
        let (_, malformed) = Numbered::parse(more).unwrap_err();
        assert!(malformed.to_string().contains("\"token\" is no part of it"));
    }

    proptest! {
        #[test]
        fn whatever_a_client_sends_is_a_command_or_a_short_error(text in ".{0,200}") {
            if let Err((_, malformed)) = Numbered::parse(&text) {
                prop_assert!(malformed.to_string().len() < 600);
            }
        }

        #[test]
        fn a_value_of_any_length_is_repeated_in_short(value in ".{0,2000}") {
            let command = serde_json::json!({ "op": "arm", "armed": value });
            let (_, malformed) = read(&command.to_string()).unwrap_err();
            prop_assert!(malformed.to_string().len() < 600, "{malformed}");
        }
    }
}
