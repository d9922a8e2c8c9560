use crate::judges::FrameChoice;
use serde::{Deserialize, Serialize};

/// ImaginedTrial episodes of a policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicySettings {
    /// Most tasks, spread over all.
    pub tasks: usize,
    /// Trials per task, which differ in the noise.
    pub trials: usize,
    /// Model steps of a trial.
    pub steps: usize,
    /// Tasks with a trial in the report.
    pub strips: usize,
    /// Inputs named by the arguments, which win over a settings file.
    #[serde(default)]
    pub inputs: PolicyInputs,
}

/// All other inputs that affect the results. Files are identified by their contents.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PolicyInputs {
    /// `recorded`, `still`, or the command.
    pub policy: String,
    /// SHA-256 of the file of tasks.
    pub tasks: Option<String>,
    /// Whether trials have other instructions.
    pub other_instructions: bool,
    /// SHA-256 of the other first frames.
    pub start_images: Option<String>,
    /// SHA-256 of the prompts file, if not the paper's.
    pub prompts: Option<String>,
    /// Frames shown to the judges.
    pub frames: Option<FrameChoice>,
    /// The judges.
    pub judges: Vec<JudgeInputs>,
}

/// The inputs that affect a judge's answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JudgeInputs {
    /// Its name.
    pub name: String,
    /// Its model.
    pub model: String,
    /// Its temperature.
    pub temperature: Option<f64>,
    /// Its seed.
    pub seed: Option<u64>,
}

/// What the description of a success probe as a judge begins with.
const PROBE: &str = "success probe, ";

impl JudgeInputs {
    /// A success probe of this kind as a judge.
    #[must_use]
    pub fn probe(name: &str, kind: &str) -> Self {
        Self {
            name: name.to_owned(),
            model: format!("{PROBE}{kind}"),
            temperature: None,
            seed: None,
        }
    }

    /// Whether it is a success probe, not a vision-language model.
    #[must_use]
    pub fn is_probe(&self) -> bool {
        self.model.starts_with(PROBE)
    }
}
