//! What is measured: the paper's three questions, and what a user asks besides.

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
    /// Do decoded rollouts look right? (the paper, appendix C.2)
    Fidelity,
    /// Do they obey actions? (appendix C.1, A)
    Control,
    /// Do latents tell actions and success? (appendix C.3)
    Latents,
    /// What becomes of a policy in the imagined environment? (appendix C.1, B to D)
    Policy,
    /// Where may the model be trusted? (beyond the paper)
    Robustness,
    /// What does it take to compute? (table "Architecture size and compute")
    Cost,
}

impl Suite {
    /// All, in the order of a report.
    pub const ALL: [Self; 6] = [
        Self::Fidelity,
        Self::Control,
        Self::Latents,
        Self::Policy,
        Self::Robustness,
        Self::Cost,
    ];

    /// Its name, by which its metrics' names begin.
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
            Self::Fidelity => "Do decoded rollouts look like what came?",
            Self::Control => "Do predictions obey the actions?",
            Self::Latents => "Do predicted latents tell actions and success?",
            Self::Policy => "What becomes of a policy in the imagined environment?",
            Self::Robustness => "Where may the model be trusted?",
            Self::Cost => "What does it take to compute?",
        }
    }
}

impl fmt::Display for Suite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
