//! The text of `.msg`, `.srv` and `.action` files: <https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html>.
//! The build script uses this file too.

use super::{
    error::DescriptionError,
    field::{Field, FieldType, IndividualType, is_identifier},
};

/// A field or a constant.
pub(crate) struct Declaration<'a> {
    pub type_name: &'a str,
    pub name: &'a str,
    /// `= VALUE` of a constant; of a field, its default value or nothing.
    pub value: &'a str,
}

/// Reads the text of one message type. Constants and default values are no part of it.
pub(crate) fn parse(name: &str, text: &str) -> Result<IndividualType, DescriptionError> {
    let parts: Vec<&str> = name.split('/').collect();
    let [package, "msg" | "srv" | "action", type_name] = parts[..] else {
        return Err(DescriptionError::Name(name.to_owned()));
    };
    if !is_identifier(package) || !is_identifier(type_name) {
        return Err(DescriptionError::Name(name.to_owned()));
    }
    let mut fields = Vec::new();
    for line in text.lines() {
        let code = line.split_once('#').map_or(line, |(code, _)| code).trim();
        if code.is_empty() {
            continue;
        }
        let declaration = declaration(name, code)?;
        if declaration.value.starts_with('=') {
            continue;
        }
        let field_type = FieldType::parse(package, declaration.type_name);
        fields.push(Field {
            name: declaration.name.to_owned(),
            field_type: field_type.ok_or_else(|| DescriptionError::FieldType {
                name: name.to_owned(),
                found: declaration.type_name.to_owned(),
            })?,
        });
    }
    if fields.is_empty() {
        fields.push(Field::placeholder());
    }
    Ok(IndividualType {
        name: name.to_owned(),
        fields,
    })
}

/// The parts of a service or an action, which lines `---` separate.
pub(crate) fn split_parts(text: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    for line in text.split_inclusive('\n') {
        match parts.last_mut() {
            Some(part) if line.trim() != "---" => part.push_str(line),
            _ => parts.push(String::new()),
        }
    }
    parts
}

/// Reads a line, given without its comment. `name` is the type that it belongs to.
pub(crate) fn declaration<'a>(
    name: &str,
    code: &'a str,
) -> Result<Declaration<'a>, DescriptionError> {
    let invalid = || DescriptionError::Line {
        name: name.to_owned(),
        line: code.to_owned(),
    };
    let (type_name, rest) = code.split_once(char::is_whitespace).ok_or_else(invalid)?;
    let rest = rest.trim_start();
    let end = rest.find(|c: char| c == '=' || c.is_whitespace());
    let (field_name, value) = rest.split_at(end.unwrap_or(rest.len()));
    if !is_identifier(field_name) {
        return Err(invalid());
    }
    Ok(Declaration {
        type_name,
        name: field_name,
        value: value.trim_start(),
    })
}
