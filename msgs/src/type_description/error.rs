/// Why a definition gives no description.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptionError {
    /// A type name that is none.
    #[error("expected a type name such as package/msg/Type, got `{0}`")]
    Name(String),
    /// A line that is neither field nor constant.
    #[error("{name}: expected `type name`, got `{line}`")]
    Line {
        /// The type with the line.
        name: String,
        /// The line, without its comment.
        line: String,
    },
    /// A field of a type that ROS does not have.
    #[error("{name}: expected a type of ROS, got `{found}`")]
    FieldType {
        /// The type with the field.
        name: String,
        /// What stands where the field's type should.
        found: String,
    },
    /// Text that is not the IDL of a message.
    #[error("IDL: expected {expected}, got `{found}`")]
    Idl {
        /// What belongs there.
        expected: String,
        /// What stands there.
        found: String,
    },
    /// A type that is named but not defined.
    #[error("expected the definition of {name}, which {by} names, got none")]
    Missing {
        /// The type that is missing.
        name: String,
        /// The type that names it.
        by: String,
    },
    /// More types than any message has.
    #[error("{name}: expected at most {limit} types in one message, got more")]
    TooMany {
        /// The type that was requested.
        name: String,
        /// The limit.
        limit: usize,
    },
    /// A service whose text is that of a message.
    #[error("{name}: expected a line `---` between request and response, got none")]
    NoResponse {
        /// The service.
        name: String,
    },
    /// An action whose text does not have three parts.
    #[error("{name}: expected two lines `---` between goal, result and feedback, got {found}")]
    NoParts {
        /// The action.
        name: String,
        /// Lines `---` that there are.
        found: usize,
    },
}
