//! The text of `.msg`, `.srv` and `.action` files: <https://docs.ros.org/en/rolling/Concepts/Basic/About-Interfaces.html>.

use super::{
    DescriptionError, IndividualType,
    field::{Field, FieldType, is_identifier},
};

/// Reads the text of one message type; constants and default values are passed over.
pub(super) fn parse(name: &str, text: &str) -> Result<IndividualType, DescriptionError> {
    let parts: Vec<&str> = name.split('/').collect();
    let [package, "msg" | "srv" | "action", type_name] = parts[..] else {
        return Err(DescriptionError::Name(name.to_owned()));
    };
    if !is_identifier(package) || !is_identifier(type_name) {
        return Err(DescriptionError::Name(name.to_owned()));
    }
    let mut fields = Vec::new();
    for line in text.lines() {
        let code = line.split('#').next().unwrap_or_default().trim();
        if !code.is_empty() {
            fields.extend(field(name, package, code)?);
        }
    }
    if fields.is_empty() {
        fields.push(Field::placeholder());
    }
    Ok(IndividualType {
        name: name.to_owned(),
        fields,
    })
}

/// The parts of a service or an action: what stands between the lines `---`.
pub(super) fn split_parts(text: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    for line in text.split_inclusive('\n') {
        match parts.last_mut() {
            Some(part) if line.trim() != "---" => part.push_str(line),
            _ => parts.push(String::new()),
        }
    }
    parts
}

/// The field of a line; none where the line is a constant, `type NAME = value`.
fn field(name: &str, package: &str, code: &str) -> Result<Option<Field>, DescriptionError> {
    let not_a_field = || DescriptionError::Line {
        name: name.to_owned(),
        line: code.to_owned(),
    };
    let (field_type, rest) = code
        .split_once(char::is_whitespace)
        .ok_or_else(not_a_field)?;
    let rest = rest.trim_start();
    let end = rest
        .find(|c: char| c == '=' || c.is_whitespace())
        .unwrap_or(rest.len());
    let (field_name, after) = rest.split_at_checked(end).ok_or_else(not_a_field)?;
    if !is_identifier(field_name) {
        return Err(not_a_field());
    }
    if after.trim_start().starts_with('=') {
        return Ok(None);
    }
    let parsed =
        FieldType::parse(package, field_type).ok_or_else(|| DescriptionError::FieldType {
            name: name.to_owned(),
            found: field_type.to_owned(),
        })?;
    Ok(Some(Field {
        name: field_name.to_owned(),
        field_type: parsed,
    }))
}
