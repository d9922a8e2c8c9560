/// An invalid definition.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptionError {
    /// An invalid name of a type.
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
        /// The unknown type.
        found: String,
    },
    /// Text that is not the IDL of a message.
    #[error("IDL: expected {expected}, got `{found}`")]
    Idl {
        /// The expected token.
        expected: String,
        /// The token that was found.
        found: String,
    },
    /// A missing dependency.
    #[error("expected the definition of {name}, which {by} names, got none")]
    Missing {
        /// The type that is missing.
        name: String,
        /// The type that names it.
        by: String,
    },
    /// Too many types in one message.
    #[error("{name}: expected at most {limit} types in one message, got more")]
    TooMany {
        /// The type that was requested.
        name: String,
        /// The limit.
        limit: usize,
    },
    /// A service without a response.
    #[error("{name}: expected a line `---` between request and response, got none")]
    NoResponse {
        /// The service.
        name: String,
    },
    /// An action without three parts.
    #[error("{name}: expected two lines `---` between goal, result and feedback, got {found}")]
    NoParts {
        /// The action.
        name: String,
        /// Number of lines `---`.
        found: usize,
    },
}
