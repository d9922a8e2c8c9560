//! The suites of the evaluation: the paper's three questions, and more.

use std::fmt;

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// A part of the evaluation.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Suite {
    /// Do decoded rollouts match the camera's frames? (the paper, appendix C.2)
    Fidelity,
    /// Do predictions obey the actions? (appendix C.1, A)
    Control,
    /// Do predicted latents encode actions and success? (appendix C.3)
    Latents,
    /// How does a policy perform in the imagined environment? (appendix C.1, B to D)
    Policy,
    /// Which inputs does the model handle reliably? (beyond the paper)
    Robustness,
    /// How much computation does it need? (table "Architecture size and compute")
    Cost,
}

impl Suite {
    /// All suites, in the order of a report.
    pub const ALL: [Self; 6] = [
        Self::Fidelity,
        Self::Control,
        Self::Latents,
        Self::Policy,
        Self::Robustness,
        Self::Cost,
    ];

    /// Name, the prefix of its figures.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fidelity => "fidelity",
            Self::Control => "control",
            Self::Latents => "latents",
            Self::Policy => "policy",
            Self::Robustness => "robustness",
            Self::Cost => "cost",
        }
    }

    /// The question that it answers.
    #[must_use]
    pub fn question(self) -> &'static str {
        match self {
            Self::Fidelity => "Do decoded rollouts match the camera's frames?",
            Self::Control => "Do predictions obey the actions?",
            Self::Latents => "Do predicted latents encode actions and success?",
            Self::Policy => "How does a policy perform in the imagined environment?",
            Self::Robustness => "Which inputs does the model handle reliably?",
            Self::Cost => "How much computation does it need?",
        }
    }
}

impl fmt::Display for Suite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
