use serde::{Deserialize, Serialize};

/// A figure of a measurement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Name, such as `ratio_k1`.
    pub name: String,
    /// The value.
    pub value: f64,
}

impl Figure {
    /// A named value.
    #[must_use]
    pub fn new(name: impl Into<String>, value: f64) -> Self {
        Self {
            name: name.into(),
            value,
        }
    }
}
