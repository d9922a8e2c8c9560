//! The text of a record: its message, then its fields as `name=value`.

use std::fmt::{Debug, Write as _};
use tracing::field::{Field, Visit};

/// Collects the fields of an event or a span.
#[derive(Debug, Default)]
pub(super) struct Record {
    message: String,
    fields: String,
    /// The field `node`, which names a span's node.
    pub(super) node: Option<String>,
}

impl Record {
    pub(super) fn into_text(self) -> String {
        let Self {
            mut message,
            fields,
            ..
        } = self;
        message.push_str(&fields);
        message
    }

    fn add(&mut self, name: &str, value: impl std::fmt::Display) {
        // writing into a String cannot fail
        write!(self.fields, " {name}={value}").ok();
    }
}

impl Visit for Record {
    fn record_str(&mut self, field: &Field, value: &str) {
        match field.name() {
            "message" => self.message.push_str(value),
            "node" => self.node = Some(value.to_owned()),
            name => self.add(name, value),
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        match field.name() {
            "message" => write!(self.message, "{value:?}").unwrap_or_default(),
            "node" => self.node = Some(format!("{value:?}")),
            name => self.add(name, format_args!("{value:?}")),
        }
    }
}
