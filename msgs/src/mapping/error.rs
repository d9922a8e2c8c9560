use crate::DescriptionError;

/// Why messages of one definition cannot become messages of another.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MappingError {
    /// A definition that cannot be understood.
    #[error(transparent)]
    Definition(#[from] DescriptionError),
    /// A field of both, whose types do not fit.
    #[error("field {field} has the type {theirs}, which does not fit into {ours}")]
    FieldType {
        /// The field's path.
        field: String,
        /// Its type in the source.
        theirs: String,
        /// Its type in the target.
        ours: String,
    },
    /// A field of both, of two message types.
    #[error("field {field} has the type {theirs}, expected {ours}")]
    Nested {
        /// The field's path.
        field: String,
        /// Its type in the source.
        theirs: String,
        /// Its type in the target.
        ours: String,
    },
    /// Two types without a common field.
    #[error("no field of {name} is in the definition{}", at(field))]
    NothingInCommon {
        /// The type.
        name: String,
        /// The path of the field of this type; empty for the message itself.
        field: String,
    },
    /// A type whose layout is unknown.
    #[error("field {field} has the type {found}, whose layout is not known")]
    Layout {
        /// Type and field.
        field: String,
        /// The field's type.
        found: String,
    },
    /// Types within types, without an end.
    #[error("{0} contains itself, or too many types within types")]
    TooDeep(String),
}

fn at(field: &str) -> String {
    match field {
        "" => String::new(),
        field => format!(", at {field}"),
    }
}

/// Why bytes are not a message of a definition, or do not fit another.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ConvertError {
    /// Fewer bytes than the encapsulation header has.
    #[error("expected a 4-byte CDR header, got {0} bytes")]
    NoHeader(usize),
    /// An encapsulation of another kind.
    #[error("expected plain CDR (representation 0x0000, 0x0001, 0x0006 or 0x0007), got 0x{0:04x}")]
    Representation(u16),
    /// The bytes end within a field.
    #[error(
        "expected {expected} bytes at byte {at}, got {left}: the message does not fit its definition"
    )]
    TooShort {
        /// Where, counted from the header's end.
        at: usize,
        /// Bytes that are needed there.
        expected: u64,
        /// Bytes that are there.
        left: usize,
    },
    /// Bytes are left that padding does not explain.
    #[error(
        "expected the message to end after {used} bytes, got {length}: it does not fit its definition"
    )]
    Trailing {
        /// Bytes that the definition explains, without the header.
        used: usize,
        /// Bytes, without the header.
        length: usize,
    },
    /// A string without its zero byte.
    #[error("expected a string that ends with a zero byte at byte {at}")]
    Text {
        /// Where, counted from the header's end.
        at: usize,
    },
    /// More elements, or a longer string, than the target allows.
    #[error("field {field}: expected at most {limit}, got {found}")]
    Bound {
        /// The field's name.
        field: String,
        /// The bound.
        limit: u64,
        /// Elements, or bytes, of the message.
        found: u64,
    },
    /// The converted message would be larger than any message.
    #[error("the converted message has more than {limit} bytes")]
    TooLarge {
        /// The limit.
        limit: usize,
    },
    /// Values within values, without an end.
    #[error("types are nested too deeply")]
    TooDeep,
}
