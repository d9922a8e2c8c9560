//! The help text of a node, `wm NODE --help`.

use super::NodeDefinition;
use crate::{Direction, EndpointSpec, ParameterSpec, parameters::Range};
use std::fmt::Write as _;

/// Column at which lines are broken.
const WIDTH: usize = 100;

impl<E> NodeDefinition<E> {
    /// Topics, services, actions and parameters, as text.
    #[must_use]
    pub fn help(&self) -> String {
        let mut text = String::new();
        for (title, direction) in [
            ("Subscribes to", Direction::Subscribed),
            ("Publishes", Direction::Published),
            ("Services", Direction::Served),
            ("Actions", Direction::Performed),
            ("Calls", Direction::Called),
        ] {
            let specs = self.endpoints_of(direction);
            if !specs.is_empty() {
                heading(&mut text, title);
                for spec in &specs {
                    endpoint(&mut text, spec);
                }
            }
        }
        heading(
            &mut text,
            "Parameters (--ros-args -p NAME:=VALUE or --params-file FILE; dynamic: can be changed while the node runs)",
        );
        for spec in self.specs() {
            parameter(&mut text, &spec);
        }
        let lifecycle = if self.is_managed {
            ". This is a managed node, so it also has the lifecycle services (~/change_state, ~/get_state, ...)"
        } else {
            ""
        };
        wrapped(
            &mut text,
            "",
            &format!(
                "\nEvery node also has use_sim_time, the parameter and logger services, /parameter_events, /rosout and \
                 /diagnostics{lifecycle}. Relative names are in the namespace /wm; ~ stands for the node's name."
            ),
        );
        text
    }

    /// The topics as rows of a Markdown table: node, direction, name, type, QoS.
    #[must_use]
    pub fn table_rows(&self) -> String {
        let mut text = String::new();
        for spec in (self.endpoints)() {
            let (direction, qos) = match (spec.direction, spec.qos) {
                (Direction::Subscribed, Some(qos)) => ("subscribes", qos.to_string()),
                (Direction::Published, Some(qos)) => ("publishes", qos.to_string()),
                (Direction::Performed, _) => ("performs", String::new()),
                (Direction::Called, _) => ("calls", String::new()),
                _ => ("serves", String::new()),
            };
            let (name, type_name, text_) = (spec.name, spec.type_name, spec.text);
            line(
                &mut text,
                &format!(
                    "| {} | {direction} | `{name}` | `{type_name}` | {qos} | {text_} |",
                    self.name
                ),
            );
        }
        text
    }
}

/// Writing to a `String` cannot fail.
fn line(text: &mut String, line: &str) {
    writeln!(text, "{line}").ok();
}

fn heading(text: &mut String, title: &str) {
    if !text.is_empty() {
        line(text, "");
    }
    line(text, &format!("{title}:"));
}

fn endpoint(text: &mut String, spec: &EndpointSpec) {
    let qos = spec.qos.map(|qos| format!("  ({qos})")).unwrap_or_default();
    line(text, &format!("  {}  {}{qos}", spec.name, spec.type_name));
    wrapped(text, "      ", &spec.text);
}

fn parameter(text: &mut String, spec: &ParameterSpec) {
    let descriptor = &spec.descriptor;
    let kind = spec.default.kind();
    let mut facts = vec![format!("default {}", spec.default)];
    if !descriptor.choices.is_empty() {
        facts.push(format!("one of {}", descriptor.choices_in_words()));
    }
    if let Some(range) = descriptor.range.as_ref().and_then(range_in_words) {
        facts.push(range);
    }
    if !descriptor.read_only {
        facts.push("dynamic".to_owned());
    }
    line(
        text,
        &format!("  {}  {kind}, {}", spec.name, facts.join("; ")),
    );
    wrapped(text, "      ", &descriptor.description);
}

/// Only limits that are narrower than the type's own.
pub(super) fn range_in_words(range: &Range) -> Option<String> {
    let (from, to) = match range {
        Range::Integers { from, to } => (
            (*from != i64::MIN).then(|| from.to_string()),
            // the limits of 32 and 64 bit numbers
            (*to < i64::from(i32::MAX)).then(|| to.to_string()),
        ),
        Range::Doubles { from, to } => (Some(format!("{from:?}")), Some(format!("{to:?}"))),
    };
    match (from, to) {
        (Some(from), Some(to)) => Some(format!("{from} to {to}")),
        (Some(from), None) => Some(format!("at least {from}")),
        (None, Some(to)) => Some(format!("at most {to}")),
        (None, None) => None,
    }
}

/// `words` in lines of at most [`WIDTH`], each after `indent`; line breaks in it stay.
pub(super) fn wrapped(text: &mut String, indent: &str, words: &str) {
    for paragraph in words.split('\n') {
        let mut current = indent.to_owned();
        for word in paragraph.split_whitespace() {
            let is_empty = current.len() == indent.len();
            if !is_empty && current.chars().count() + 1 + word.chars().count() > WIDTH {
                line(text, &current);
                indent.clone_into(&mut current);
                current.push_str(word);
            } else {
                if !is_empty {
                    current.push(' ');
                }
                current.push_str(word);
            }
        }
        line(text, current.trim_end());
    }
}
