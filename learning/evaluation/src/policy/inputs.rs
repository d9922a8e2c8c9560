use crate::judges::FrameChoice;
use serde::{Deserialize, Serialize};

/// Imagined episodes of a policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicySettings {
    /// Tasks at most, spread over all.
    pub tasks: usize,
    /// Trials of each, which differ in the noise.
    pub trials: usize,
    /// Model steps of a trial.
    pub steps: usize,
    /// Tasks of which the report shows a trial.
    pub strips: usize,
    /// What the arguments name, whatever a file of settings says.
    #[serde(default)]
    pub inputs: PolicyInputs,
}

/// What else decides of the results: who acts in what, and who judges. Files are named by their contents.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PolicyInputs {
    /// `recorded`, `still`, or the command.
    pub policy: String,
    /// SHA-256 of the file of tasks.
    pub tasks: Option<String>,
    /// Whether there are trials under other instructions.
    pub other_instructions: bool,
    /// SHA-256 of the first frames of trials that begin with others.
    pub start_images: Option<String>,
    /// SHA-256 of the file of prompts, if it is not the paper's.
    pub prompts: Option<String>,
    /// Which frames the judges see.
    pub frames: Option<FrameChoice>,
    /// The judges.
    pub judges: Vec<JudgeInputs>,
}

/// What decides of a judge's answers.
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
