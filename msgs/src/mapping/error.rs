use crate::DescriptionError;

/// Two definitions whose messages cannot be converted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MappingError {
    /// An invalid definition.
    #[error(transparent)]
    Definition(#[from] DescriptionError),
    /// A common field whose types do not fit.
    #[error("field {field} has the type {theirs}, which does not fit into {ours}")]
    FieldType {
        /// The field's path.
        field: String,
        /// Its type in the source.
        theirs: String,
        /// Its type in the target.
        ours: String,
    },
    /// A common field of two different message types.
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
    /// Types that are nested too deeply.
    #[error("{0} contains itself, or too many types within types")]
    TooDeep(String),
}

fn at(field: &str) -> String {
    match field {
        "" => String::new(),
        field => format!(", at {field}"),
    }
}

/// Bytes that are not a message of a definition, or do not fit another definition.
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
        /// Position after the header.
        at: usize,
        /// Bytes that the definition needs.
        expected: u64,
        /// Bytes that are left.
        left: usize,
    },
    /// More bytes follow than padding has.
    #[error(
        "expected the message to end after {used} bytes, got {length}: it does not fit its definition"
    )]
    Trailing {
        /// Bytes that the definition needs, without the header.
        used: usize,
        /// Bytes, without the header.
        length: usize,
    },
    /// A string without its zero byte.
    #[error("expected a string that ends with a zero byte at byte {at}")]
    Text {
        /// Position after the header.
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
    /// The converted message would be too large.
    #[error("the converted message has more than {limit} bytes")]
    TooLarge {
        /// The limit.
        limit: usize,
    },
    /// Values that are nested too deeply.
    #[error("types are nested too deeply")]
    TooDeep,
}
