use serde::{Deserialize, Serialize};

/// Start and instruction of a trial.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Condition {
    /// As recorded.
    #[default]
    Recorded,
    /// Another instruction that does not match the scene: the paper's "OOD instruction".
    OtherInstruction,
    /// Another first frame, for example with distractors: the paper's "OOD distractor".
    OtherFrame,
}

impl Condition {
    /// Out-of-distribution conditions.
    pub const CHANGED: [Self; 2] = [Self::OtherInstruction, Self::OtherFrame];

    /// Prefix of its figures.
    #[must_use]
    pub fn prefix(self) -> &'static str {
        match self {
            Self::Recorded => "",
            Self::OtherInstruction => "ood_instruction_",
            Self::OtherFrame => "ood_distractor_",
        }
    }

    /// Suffix of its units.
    #[must_use]
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Recorded => "",
            Self::OtherInstruction => ", other instruction",
            Self::OtherFrame => ", other first frame",
        }
    }

    /// Name in tables.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Recorded => "as recorded",
            Self::OtherInstruction => "other instruction",
            Self::OtherFrame => "other first frame",
        }
    }
}
