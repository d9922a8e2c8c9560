//! The annotated parameter file of a node.

use super::{
    NodeDefinition,
    help::{range_in_words, wrapped},
};
use crate::{ParameterSpec, value::Value};
use std::fmt::Write as _;

impl<E> NodeDefinition<E> {
    /// A parameter file with every parameter at its default, each with the description of `ros2 param describe`.
    #[must_use]
    pub fn params_file(&self) -> String {
        let mut text = String::new();
        let name = self.name;
        wrapped(
            &mut text,
            "# ",
            &format!(
                "Parameters of the {name}. The values are the defaults. Written by: wm {name} --print-params"
            ),
        );
        write!(text, "/**/{name}:\n  ros__parameters:\n").ok();
        for spec in self.specs() {
            entry(&mut text, &spec);
        }
        text
    }
}

fn entry(text: &mut String, spec: &ParameterSpec) {
    let descriptor = &spec.descriptor;
    let mut facts = Vec::new();
    if !descriptor.choices.is_empty() {
        facts.push(format!("One of: {}.", descriptor.choices_in_words()));
    }
    if let Some(range) = descriptor.range.as_ref().and_then(range_in_words) {
        facts.push(format!("Range: {range}."));
    }
    if !descriptor.read_only {
        facts.push("Can be changed while the node runs.".to_owned());
    }
    let words = format!("{} {}", descriptor.description, facts.join(" "));
    wrapped(text, "    # ", &words);
    // ROS' parameter files have no empty lists
    let mark = if is_empty_list(&spec.default) {
        "# "
    } else {
        ""
    };
    let value = match &spec.default {
        Value::Double(value) => yaml_double(*value),
        Value::String(value) => yaml_text(value),
        value => value.to_string(),
    };
    writeln!(text, "    {mark}{}: {value}", spec.name).ok();
}

/// With a point, so that YAML 1.1 reads a double: `1e-6` is a text to it.
fn yaml_double(value: f64) -> String {
    let text = format!("{value:?}");
    match text.split_once('e') {
        Some((mantissa, exponent)) if !mantissa.contains('.') => format!("{mantissa}.0e{exponent}"),
        _ => text,
    }
}

/// Quotes the text if YAML needs it.
fn yaml_text(value: &str) -> String {
    let quoted = || format!("{value:?}");
    serde_yaml_ng::to_string(value).map_or_else(|_| quoted(), |text| text.trim_end().to_owned())
}

fn is_empty_list(value: &Value) -> bool {
    match value {
        Value::ByteArray(values) => values.is_empty(),
        Value::BoolArray(values) => values.is_empty(),
        Value::IntegerArray(values) => values.is_empty(),
        Value::DoubleArray(values) => values.is_empty(),
        Value::StringArray(values) => values.is_empty(),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{NodeArgs, ParameterSet as _};
    use std::io::Write as _;

    crate::parameters! {
        /// Of a test.
        #[expect(dead_code, reason = "only its table is looked at")]
        struct Parameters {
            /// Least standard deviation [model units].
            std_floor: f64 = 1e-6, in 1e-9..=10.0;
            /// Steps that are decoded; empty: all.
            steps: Vec<i64> = Vec::<i64>::new();
            /// A text that needs quotes.
            text: String = "a \"b\": c";
        }
    }

    #[test]
    fn a_file_gives_the_defaults() {
        let definition = NodeDefinition::<crate::Error> {
            name: "test",
            about: "",
            parameters: Parameters::specs,
            endpoints: Vec::new,
            chosen_topics: crate::ChosenTopics::None,
            is_managed: true,
            runs_alone: false,
            run: |_| Ok(std::process::ExitCode::SUCCESS),
            body: |_| Box::pin(async { Ok(()) }),
        };
        let written = definition.params_file();
        assert!(
            written.contains("\n    # steps: []\n") && written.contains("    std_floor: 1.0e-6\n"),
            "{written}"
        );
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(written.as_bytes()).unwrap();
        let path = file.path().display().to_string();
        let args = NodeArgs::parse(["--ros-args", "--params-file", &path]).unwrap();
        let given: Vec<_> = args
            .overrides
            .iter()
            .map(|given| (given.name.as_str(), given.value.clone()))
            .collect();
        assert_eq!(
            given,
            [
                ("autostart", Value::Bool(true)),
                ("std_floor", Value::Double(1e-6)),
                ("text", Value::String("a \"b\": c".to_owned())),
            ]
        );
    }
}
