//! One entry of a launch file while it is read. It returns values by key and type, and rejects keys that were not read,
//! as ROS 2's frontends do.

use super::{error::LaunchError, substitution::Template};
use serde_yaml_ng::{Mapping, Value};
use std::path::Path;

/// A mapping of a launch file, with its name for errors.
pub(super) struct Entity<'a> {
    file: &'a Path,
    /// For example `launch[3] node "encoder"`.
    pub entry: String,
    mapping: &'a Mapping,
    asked: Vec<&'static str>,
}

impl<'a> Entity<'a> {
    pub(crate) fn new(
        file: &'a Path,
        entry: String,
        value: &'a Value,
    ) -> Result<Self, LaunchError> {
        let Value::Mapping(mapping) = value else {
            return Err(LaunchError::Entry {
                file: file.to_owned(),
                entry,
                message: format!("expected a mapping of keys, got {}", describe(value)),
            });
        };
        Ok(Self {
            file,
            entry,
            mapping,
            asked: Vec::new(),
        })
    }

    /// The value of `key`; null counts as missing.
    pub(crate) fn value(&mut self, key: &'static str) -> Option<&'a Value> {
        self.asked.push(key);
        self.mapping.get(key).filter(|value| !value.is_null())
    }

    /// A YAML string: ROS 2's frontend refuses `default: 1.0` without quotes.
    pub(crate) fn text(&mut self, key: &'static str) -> Result<Option<&'a str>, LaunchError> {
        match self.value(key) {
            None => Ok(None),
            Some(Value::String(text)) => Ok(Some(text)),
            Some(other) => Err(self.error(format!(
                "key {key:?} must be a string (in quotes), got {}",
                describe(other)
            ))),
        }
    }

    pub(crate) fn required_text(&mut self, key: &'static str) -> Result<&'a str, LaunchError> {
        match self.text(key)? {
            Some(text) => Ok(text),
            None => Err(self.missing(key)),
        }
    }

    pub(crate) fn template(&mut self, key: &'static str) -> Result<Option<Template>, LaunchError> {
        match self.text(key)? {
            None => Ok(None),
            Some(text) => self.parse(key, text).map(Some),
        }
    }

    pub(crate) fn required_template(&mut self, key: &'static str) -> Result<Template, LaunchError> {
        let text = self.required_text(key)?;
        self.parse(key, text)
    }

    pub(crate) fn parse(&self, key: &str, text: &str) -> Result<Template, LaunchError> {
        Template::parse(text).map_err(|source| LaunchError::Substitution {
            file: self.file.to_owned(),
            entry: self.entry.clone(),
            key: key.to_owned(),
            source,
        })
    }

    /// A boolean, or a text that resolves to one.
    pub(crate) fn boolean(&mut self, key: &'static str) -> Result<Option<Template>, LaunchError> {
        match self.value(key) {
            Some(Value::Bool(value)) => self
                .parse(key, if *value { "true" } else { "false" })
                .map(Some),
            _ => self.template(key),
        }
    }

    /// A number of at least 0.
    pub(crate) fn number(&mut self, key: &'static str) -> Result<Option<f64>, LaunchError> {
        let Some(value) = self.value(key) else {
            return Ok(None);
        };
        match value
            .as_f64()
            .filter(|number| number.is_finite() && *number >= 0.0)
        {
            Some(number) => Ok(Some(number)),
            None => Err(self.error(format!(
                "key {key:?} must be a number from 0 up, got {}",
                describe(value)
            ))),
        }
    }

    /// The mappings of a list.
    pub(crate) fn entities(&mut self, key: &'static str) -> Result<Vec<Entity<'a>>, LaunchError> {
        let Some(value) = self.value(key) else {
            return Ok(Vec::new());
        };
        let Value::Sequence(items) = value else {
            return Err(self.error(format!(
                "key {key:?} must be a list of mappings, got {}",
                describe(value)
            )));
        };
        let named =
            |(index, item)| Entity::new(self.file, format!("{}: {key}[{index}]", self.entry), item);
        items.iter().enumerate().map(named).collect()
    }

    /// Rejects the keys that were not read.
    pub(crate) fn finish(self) -> Result<(), LaunchError> {
        for key in self.mapping.keys() {
            // keys that are not strings are unknown
            let name = key.as_str().unwrap_or_default();
            if !self.asked.contains(&name) {
                return Err(LaunchError::UnknownKey {
                    file: self.file.to_owned(),
                    entry: self.entry,
                    key: key
                        .as_str()
                        .map_or_else(|| describe(key), ToOwned::to_owned),
                    known: self.asked,
                });
            }
        }
        Ok(())
    }

    pub(crate) fn missing(&self, key: &str) -> LaunchError {
        self.error(format!("key {key:?} is missing"))
    }

    pub(crate) fn error(&self, message: String) -> LaunchError {
        LaunchError::Entry {
            file: self.file.to_owned(),
            entry: self.entry.clone(),
            message,
        }
    }
}

/// Describes a YAML value for error messages.
pub(super) fn describe(value: &Value) -> String {
    match value {
        Value::Null => "nothing".to_owned(),
        Value::Bool(value) => format!("the boolean {value}"),
        Value::Number(value) => format!("the number {value}"),
        Value::String(value) => format!("the string {value:?}"),
        Value::Sequence(items) => format!("a list of {} item(s)", items.len()),
        Value::Mapping(mapping) => format!("a mapping of {} key(s)", mapping.len()),
        Value::Tagged(tagged) => format!("a value with the tag {}", tagged.tag),
    }
}
