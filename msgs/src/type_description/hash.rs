use super::{Field, IndividualType, TypeDescription};
use sha2::{Digest as _, Sha256};
use std::fmt;

/// The hash of a type, version 1 (REP-2016). Types with the same names and fields have equal hashes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TypeHash([u8; 32]);

impl TypeHash {
    pub(super) fn of(description: &TypeDescription) -> Self {
        Self(Sha256::digest(json(description)).into())
    }
}

impl fmt::Display for TypeHash {
    /// `RIHS01_` and 64 hexadecimal digits.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("RIHS01_")?;
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// The canonical JSON, as `json.dumps` of `rosidl_generator_type_description` writes it: keys in this order, separated by
/// `", "` and `": "`. Names are plain identifiers and need no escapes.
fn json(description: &TypeDescription) -> String {
    format!(
        "{{\"type_description\": {}, \"referenced_type_descriptions\": [{}]}}",
        individual(&description.described),
        list(&description.referenced, individual)
    )
}

fn individual(part: &IndividualType) -> String {
    format!(
        "{{\"type_name\": \"{}\", \"fields\": [{}]}}",
        part.name,
        list(&part.fields, field)
    )
}

fn field(field: &Field) -> String {
    let field_type = &field.field_type;
    format!(
        "{{\"name\": \"{}\", \"type\": {{\"type_id\": {}, \"capacity\": {}, \"string_capacity\": {}, \
         \"nested_type_name\": \"{}\"}}}}",
        field.name,
        field_type.type_id,
        field_type.capacity,
        field_type.string_capacity,
        field_type.nested.as_deref().unwrap_or("")
    )
}

fn list<T>(items: &[T], json: fn(&T) -> String) -> String {
    items.iter().map(json).collect::<Vec<_>>().join(", ")
}
