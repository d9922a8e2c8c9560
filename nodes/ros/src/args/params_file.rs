//! `--params-file`: YAML of the form `node: {ros__parameters: {name: value}}`.
//!
//! The key is a node's full name (`/wm/encoder`), its parts may be nested, `/*` stands for one part and `/**` for any
//! number. A single part (`encoder`) matches that node in every namespace; rcl needs `/**/encoder` for that.

use super::{ArgsError, Override};
use crate::value::Value;
use serde_yaml_ng::{Mapping, Value as Yaml};
use std::path::Path;

/// The key under which a node's parameters stand.
const PARAMETERS: &str = "ros__parameters";
/// Parameter files are written by hand; a larger file is something else.
const MAX_FILE_BYTES: u64 = 4 * 1024 * 1024;

/// The nodes that a section applies to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Section {
    parts: Vec<String>,
}

impl Section {
    /// The node that the command line starts.
    pub(crate) fn own() -> Self {
        Self {
            parts: vec!["**".to_owned()],
        }
    }

    /// A section key such as `encoder`, `/wm/encoder`, `/**`.
    pub(crate) fn parse(key: &str) -> Result<Self, String> {
        let absolute = key.starts_with('/');
        let mut parts: Vec<String> = key
            .trim_start_matches('/')
            .split('/')
            .map(str::to_owned)
            .collect();
        if parts.iter().any(String::is_empty) {
            return Err(format!("a node's name; got `{key}`"));
        }
        if !absolute && parts.len() == 1 && parts.first().is_some_and(|part| part != "**") {
            parts.insert(0, "**".to_owned());
        }
        Ok(Self { parts })
    }

    /// Whether the section applies to the node of this full name.
    pub(crate) fn matches(&self, fully_qualified_name: &str) -> bool {
        let name: Vec<_> = fully_qualified_name
            .trim_start_matches('/')
            .split('/')
            .collect();
        matches(&self.parts, &name)
    }

    /// Whether several nodes may share the section; an unknown parameter is then no error.
    pub(crate) fn is_shared(&self) -> bool {
        self.parts
            .last()
            .is_some_and(|part| part == "**" || part == "*")
    }
}

fn matches(pattern: &[String], name: &[&str]) -> bool {
    let Some((first, rest)) = pattern.split_first() else {
        return name.is_empty();
    };
    match (first.as_str(), name.split_first()) {
        ("**", None) => matches(rest, name),
        ("**", Some((_, after))) => matches(rest, name) || matches(pattern, after),
        ("*", Some((_, after))) => matches(rest, after),
        (part, Some((head, after))) => part == *head && matches(rest, after),
        (_, None) => false,
    }
}

/// Reads a file into overrides, in the order of the file.
pub(super) fn read(path: &Path) -> Result<Vec<Override>, ArgsError> {
    let file = |reason| ArgsError::File {
        path: path.to_owned(),
        reason,
    };
    let content = |problem| ArgsError::FileContent {
        path: path.to_owned(),
        problem,
    };
    let size = std::fs::metadata(path).map_err(file)?.len();
    if size > MAX_FILE_BYTES {
        return Err(content(format!(
            "expected at most {MAX_FILE_BYTES} bytes, got {size}"
        )));
    }
    parse(
        &std::fs::read_to_string(path).map_err(file)?,
        &path.display().to_string(),
    )
    .map_err(content)
}

fn parse(text: &str, origin: &str) -> Result<Vec<Override>, String> {
    let yaml: Yaml =
        serde_yaml_ng::from_str(text).map_err(|error| format!("expected YAML; {error}"))?;
    let mut overrides = Vec::new();
    match &yaml {
        Yaml::Null => {}
        Yaml::Mapping(nodes) => sections(nodes, "", origin, &mut overrides)?,
        _ => return Err("expected node names as keys at the top".to_owned()),
    }
    Ok(overrides)
}

/// Walks down from namespaces to nodes.
fn sections(
    nodes: &Mapping,
    above: &str,
    origin: &str,
    overrides: &mut Vec<Override>,
) -> Result<(), String> {
    for (key, inner) in nodes {
        let key = key
            .as_str()
            .ok_or_else(|| format!("expected a node's name as key under `{above}`, got {key:?}"))?;
        let (Yaml::Mapping(inner), false) = (inner, key == PARAMETERS) else {
            return Err(format!(
                "expected `{above}/{key}` to hold `{PARAMETERS}:` with the parameters under it"
            ));
        };
        let name = if above.is_empty() {
            key.to_owned()
        } else {
            format!("{above}/{}", key.trim_start_matches('/'))
        };
        match inner.get(PARAMETERS) {
            Some(Yaml::Mapping(values)) => {
                let section = Section::parse(&name)?;
                parameters(
                    values,
                    "",
                    &section,
                    &format!("{origin}, section {name}"),
                    overrides,
                )?;
            }
            Some(Yaml::Null) => {}
            Some(_) => return Err(format!("expected a mapping under `{name}: {PARAMETERS}`")),
            None => sections(inner, &name, origin, overrides)?,
        }
    }
    Ok(())
}

/// Flattens nested keys with dots.
fn parameters(
    values: &Mapping,
    above: &str,
    section: &Section,
    origin: &str,
    overrides: &mut Vec<Override>,
) -> Result<(), String> {
    for (key, value) in values {
        let key = match key {
            Yaml::String(key) => key.clone(),
            Yaml::Number(key) => key.to_string(),
            other => {
                return Err(format!(
                    "{origin}: expected a parameter's name, got {other:?}"
                ));
            }
        };
        let name = if above.is_empty() {
            key
        } else {
            format!("{above}.{key}")
        };
        match value {
            Yaml::Mapping(inner) => parameters(inner, &name, section, origin, overrides)?,
            scalar => overrides.push(Override {
                is_shared: section.is_shared(),
                section: section.clone(),
                value: Value::from_yaml(scalar).map_err(|expected| {
                    format!("{origin}: parameter `{name}`: expected {expected}")
                })?,
                name,
                origin: origin.to_owned(),
            }),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn sections_match_as_their_wildcards_say() {
        let matching = |key: &str, name: &str| Section::parse(key).unwrap().matches(name);
        assert!(matching("/wm/encoder", "/wm/encoder"));
        assert!(matching("wm/encoder", "/wm/encoder"));
        assert!(matching("encoder", "/wm/encoder"));
        assert!(matching("encoder", "/encoder"));
        assert!(!matching("/encoder", "/wm/encoder"));
        assert!(matching("/**", "/a/b/c"));
        assert!(matching("/*/encoder", "/wm/encoder"));
        assert!(!matching("/*", "/wm/encoder"));
        assert!(matching("/**/encoder", "/encoder"));
        assert!(!matching("decoder", "/wm/encoder"));
    }

    #[test]
    fn nested_keys_are_joined_and_nested_namespaces_too() {
        let text = "/**: {ros__parameters: {use_sim_time: true}}\nwm:\n  encoder:\n    ros__parameters:\n      a: {b: 1}\n      c: [1.5]\n";
        let overrides = parse(text, "file").unwrap();
        let found: Vec<_> = overrides
            .iter()
            .map(|o| {
                (
                    o.name.as_str(),
                    o.value.clone(),
                    o.section.matches("/wm/encoder"),
                )
            })
            .collect();
        assert_eq!(
            found,
            [
                ("use_sim_time", Value::Bool(true), true),
                ("a.b", Value::Integer(1), true),
                ("c", Value::DoubleArray(vec![1.5]), true)
            ]
        );
        assert!(overrides.first().unwrap().is_shared);
        assert!(!overrides.last().unwrap().is_shared);
    }

    #[test]
    fn what_is_not_a_parameter_file_is_refused() {
        assert!(
            parse("encoder: {rate: 2}", "f")
                .unwrap_err()
                .contains("ros__parameters")
        );
        assert!(parse("ros__parameters: {rate: 2}", "f").is_err());
        assert!(parse("[1]", "f").unwrap_err().contains("node names"));
        assert!(
            parse("e: {ros__parameters: {rate: ~}}", "f")
                .unwrap_err()
                .contains("`rate`")
        );
        assert!(parse("a: [", "f").unwrap_err().contains("expected YAML"));
        assert_eq!(parse("", "f").unwrap(), []);
    }

    proptest! {
        /// Any text gives overrides or an error, never a panic.
        #[test]
        fn any_text_is_answered(text in "[a-z0-9:{}\\[\\] \n'\"&*!~/_.-]{0,80}") {
            parse(&text, "file").ok();
        }
    }
}
