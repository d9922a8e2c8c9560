//! Builds the node's parameters from a command's options.

use anyhow::Result;
use serde::Serialize;

/// Arguments for a node, after `--ros-args`.
#[derive(Debug)]
pub(crate) struct Parameters(Vec<String>);

impl Parameters {
    pub(crate) fn new() -> Self {
        Self(vec!["--ros-args".to_owned()])
    }

    /// Adds a parameter; JSON is valid YAML.
    pub(crate) fn set(&mut self, name: &str, value: impl Serialize) -> Result<()> {
        self.0.extend([
            "-p".to_owned(),
            format!("{name}:={}", serde_json::to_string(&value)?),
        ]);
        Ok(())
    }

    /// Adds a parameter if it is given.
    pub(crate) fn set_some(&mut self, name: &str, value: Option<impl Serialize>) -> Result<()> {
        value.map_or(Ok(()), |value| self.set(name, value))
    }

    /// A remapping rule, `from:=to`.
    pub(crate) fn remap(&mut self, rule: &str) {
        self.0.extend(["-r".to_owned(), rule.to_owned()]);
    }

    pub(crate) fn log_level(&mut self, level: Option<String>) {
        let words = level.map(|level| ["--log-level".to_owned(), level]);
        self.0.extend(words.into_iter().flatten());
    }

    /// The arguments, followed by the user's, which take precedence.
    pub(crate) fn with(mut self, ros_args: Vec<String>) -> Vec<String> {
        self.0.extend(ros_args.into_iter().skip(1));
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_yaml_and_user_arguments_come_last() {
        let mut parameters = Parameters::new();
        parameters.set("bag", "a \"b\"").unwrap();
        parameters.set("rate", 2.0).unwrap();
        parameters.set_some("size", None::<i64>).unwrap();
        parameters.remap("/a:=/b");
        let user = ["--ros-args", "-p", "rate:=3"]
            .map(ToOwned::to_owned)
            .to_vec();
        let expected = [
            "--ros-args",
            "-p",
            "bag:=\"a \\\"b\\\"\"",
            "-p",
            "rate:=2.0",
            "-r",
            "/a:=/b",
            "-p",
            "rate:=3",
        ];
        assert_eq!(parameters.with(user), expected);
    }
}
