use serde::{Deserialize, Serialize};

/// What an episode begins with, and what the policy is told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Condition {
    /// As recorded.
    #[default]
    Recorded,
    /// Another instruction, which does not go with the scene: the paper's "OOD instruction".
    OtherInstruction,
    /// Another first frame, as with things that distract: the paper's "OOD distractor".
    OtherFrame,
}

impl Condition {
    /// Those out of distribution.
    pub const CHANGED: [Self; 2] = [Self::OtherInstruction, Self::OtherFrame];

    /// What the names of its figures begin with.
    #[must_use]
    pub fn prefix(self) -> &'static str {
        match self {
            Self::Recorded => "",
            Self::OtherInstruction => "ood_instruction_",
            Self::OtherFrame => "ood_distractor_",
        }
    }

    /// What the names of its units end with.
    #[must_use]
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Recorded => "",
            Self::OtherInstruction => ", other instruction",
            Self::OtherFrame => ", other first frame",
        }
    }

    /// For a table.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Recorded => "as recorded",
            Self::OtherInstruction => "other instruction",
            Self::OtherFrame => "other first frame",
        }
    }
}
