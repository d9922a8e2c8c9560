use std::fmt;

/// The number of a nested type (`type_description_interfaces/msg/FieldType`).
const NESTED: u8 = 1;
const UINT8: u8 = 3;
const WSTRING: u8 = 18;
/// The offset of a bounded string's number: 17 to 21, 18 to 22.
const BOUNDED_STRING: u8 = 4;
/// Offsets from an element's number to an array, a bounded and an unbounded sequence of it.
const ARRAY: u8 = 48;
const BOUNDED_SEQUENCE: u8 = 96;
const UNBOUNDED_SEQUENCE: u8 = 144;

/// Types without parts by their name in `.msg` text. rosidl makes `char` an unsigned byte.
const PRIMITIVES: [(&str, u8); 15] = [
    ("int8", 2),
    ("uint8", UINT8),
    ("int16", 4),
    ("uint16", 5),
    ("int32", 6),
    ("uint32", 7),
    ("int64", 8),
    ("uint64", 9),
    ("float32", 10),
    ("float64", 11),
    ("char", UINT8),
    ("bool", 15),
    ("byte", 16),
    ("string", 17),
    ("wstring", WSTRING),
];

/// One type, without the types of its fields.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IndividualType {
    /// `package/msg/Type`; of a service `package/srv/Type`, and with `_Request`, `_Response`, `_Event` its parts; of an
    /// action `package/action/Type`, and its parts in the same way.
    pub name: String,
    /// In order.
    pub fields: Vec<Field>,
}

/// One field of a type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// Its type.
    pub field_type: FieldType,
}

/// The type of a field, in the terms of `type_description_interfaces/msg/FieldType`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldType {
    /// Which type, and whether it is an array or a sequence of it.
    pub type_id: u8,
    /// Length of an array, limit of a bounded sequence, else 0.
    pub capacity: u64,
    /// Limit of a bounded string \[byte\], else 0.
    pub string_capacity: u64,
    /// The message type of the element, `package/msg/Type`; `None` for other types.
    pub nested: Option<String>,
}

impl Field {
    /// A field of a nested type.
    pub(crate) fn nested(name: &str, type_name: &str) -> Self {
        Self {
            name: name.to_owned(),
            field_type: FieldType {
                type_id: NESTED,
                capacity: 0,
                string_capacity: 0,
                nested: Some(type_name.to_owned()),
            },
        }
    }

    /// The field as a sequence of at most `capacity` elements.
    pub(crate) fn at_most(mut self, capacity: u64) -> Self {
        self.field_type.type_id += BOUNDED_SEQUENCE;
        self.field_type.capacity = capacity;
        self
    }

    /// The field that rosidl gives a type without fields: IDL has no empty structs.
    pub(crate) fn placeholder() -> Self {
        Self {
            name: "structure_needs_at_least_one_member".to_owned(),
            field_type: FieldType {
                type_id: UINT8,
                capacity: 0,
                string_capacity: 0,
                nested: None,
            },
        }
    }
}

impl FieldType {
    /// Reads a type of `.msg` text, `string<=9[<=3]` for example; a message type without a package is of `package`.
    /// `None`: not a type.
    pub(crate) fn parse(package: &str, text: &str) -> Option<Self> {
        let (element, offset, capacity) = match text.strip_suffix(']') {
            None => (text, 0, 0),
            Some(text) => {
                let (element, size) = text.rsplit_once('[')?;
                match (size, size.strip_prefix("<=")) {
                    ("", _) => (element, UNBOUNDED_SEQUENCE, 0),
                    (_, Some(limit)) => (element, BOUNDED_SEQUENCE, limit.parse().ok()?),
                    (length, None) => (element, ARRAY, length.parse().ok()?),
                }
            }
        };
        let (element, string_capacity) = match element.split_once("<=") {
            Some((string @ ("string" | "wstring"), limit)) => (string, limit.parse().ok()?),
            Some(_) => return None,
            None => (element, 0),
        };
        let primitive = PRIMITIVES.iter().find(|(name, _)| *name == element);
        let (type_id, nested) = match primitive {
            Some((_, type_id)) if string_capacity > 0 => (type_id + BOUNDED_STRING, None),
            Some((_, type_id)) => (*type_id, None),
            None => (NESTED, Some(nested_name(package, element)?)),
        };
        Some(Self {
            type_id: type_id + offset,
            capacity,
            string_capacity,
            nested,
        })
    }
}

impl fmt::Display for FieldType {
    /// As `.msg` text has it: `geometry_msgs/Point[]`, `string<=9`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (container, element) = (self.type_id / ARRAY, self.type_id % ARRAY);
        let base = if element > WSTRING {
            element - BOUNDED_STRING
        } else {
            element
        };
        let primitive = PRIMITIVES.iter().find(|(_, type_id)| *type_id == base);
        match (&self.nested, primitive) {
            (Some(nested), _) => f.write_str(&nested.replace("/msg/", "/"))?,
            (None, Some((name, _))) => f.write_str(name)?,
            (None, None) => write!(f, "type {element}")?,
        }
        if self.string_capacity > 0 {
            write!(f, "<={}", self.string_capacity)?;
        }
        match container {
            0 => Ok(()),
            1 => write!(f, "[{}]", self.capacity),
            2 => write!(f, "[<={}]", self.capacity),
            _ => f.write_str("[]"),
        }
    }
}

fn nested_name(package: &str, text: &str) -> Option<String> {
    let (package, name) = match text.split('/').collect::<Vec<_>>()[..] {
        [name] => (package, name),
        [package, name] | [package, "msg", name] => (package, name),
        _ => return None,
    };
    let is_type = name.starts_with(|c: char| c.is_ascii_uppercase());
    (is_type && is_identifier(name) && is_identifier(package))
        .then(|| format!("{package}/msg/{name}"))
}

/// Whether `text` may be the name of a package, type or field: it stands in the JSON without escapes.
pub(crate) fn is_identifier(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}
