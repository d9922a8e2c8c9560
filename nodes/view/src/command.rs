//! What a client may ask for.

use serde::{Deserialize, Deserializer, de::Error as _};

/// What the page may do beyond looking.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Permission {
    /// Nothing, except to stop the executor: that only ever takes motion away.
    Nothing,
    /// Set goals, choose candidates and reset the nodes' histories. Where the executor is armed, the arm may move by it.
    Goals,
    /// Arm the executor too.
    All,
}

impl Permission {
    /// As the page is told.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Nothing => "none",
            Self::Goals => "goals",
            Self::All => "all",
        }
    }
}

/// A command of a client, as JSON. Those without fields have braces, without which serde would let any field pass.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "op", rename_all = "snake_case", deny_unknown_fields)]
pub enum Command {
    /// Predictor, planner and evaluator forget what they observed.
    Reset {},
    /// A picture that was seen becomes the goal.
    Goal {
        source: String,
        #[serde(deserialize_with = "stamp")]
        stamp: i64,
        #[serde(deserialize_with = "stamp")]
        observed: i64,
        k: u8,
    },
    /// A candidate is what the policy is going to do.
    Choose {
        #[serde(deserialize_with = "stamp")]
        stamp: i64,
        index: usize,
    },
    /// The executor may send commands, or no longer.
    Arm { armed: bool },
    /// Emergency stop of the executor.
    Stop {},
    /// The emergency stop is over; the executor is not armed.
    Release {},
}

fn stamp<'de, D: Deserializer<'de>>(deserializer: D) -> Result<i64, D::Error> {
    let text = String::deserialize(deserializer)?;
    text.parse().map_err(D::Error::custom)
}

impl Command {
    /// What has to be permitted for it.
    pub const fn needs(&self) -> Permission {
        match self {
            Self::Stop {} | Self::Arm { armed: false } => Permission::Nothing,
            Self::Reset {} | Self::Goal { .. } | Self::Choose { .. } => Permission::Goals,
            Self::Arm { armed: true } | Self::Release {} => Permission::All,
        }
    }
}

/// A command with the number that its answer bears.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Numbered {
    pub number: u32,
    pub command: Command,
}

impl Numbered {
    /// What a client has sent.
    ///
    /// # Errors
    /// What is wrong with it, in words.
    pub fn parse(text: &str) -> Result<Self, String> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Raw {
            number: u32,
            command: Command,
        }
        let raw: Raw =
            serde_json::from_str(text).map_err(|error| format!("not a command: {error}"))?;
        Ok(Self {
            number: raw.number,
            command: raw.command,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn commands_are_read_and_need_what_they_do() {
        let read = |text: &str| Numbered::parse(&format!("{{\"number\":7,\"command\":{text}}}"));
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
        for wrong in [
            r#"{"op":"launch"}"#,
            r#"{"op":"stop","now":true}"#,
            r#"{"op":"goal","source":"camera","stamp":17,"observed":"1","k":0}"#,
            r#"{"op":"choose","stamp":"5","index":-1}"#,
            "[]",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn whatever_a_client_sends_is_a_command_or_an_error(text in ".{0,200}") {
            let _ = Numbered::parse(&text);
        }
    }
}
