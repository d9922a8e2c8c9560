use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::judges::{
    endpoint::Usage,
    verdict::{RubricScores, SuccessScore},
};

/// A question and its outcome.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Hash of everything that affects the answer: the judge's name, the model, the prompt, the frames with their encoding, the
    /// sampling and the trial.
    pub key: String,
    /// Stamp of the rollout, as given.
    pub stamp_ns: u64,
    /// Name of the judge.
    pub judge: String,
    /// Instruction of the rollout.
    pub instruction: String,
    /// Index among the rollouts with this instruction.
    pub trial: u64,
    /// Indices of the shown frames.
    pub frames: Vec<usize>,
    /// The first request, with hashes of the frames' pixels instead of pictures.
    pub request: Value,
    /// All answers; the last one gives the verdict.
    pub answers: Vec<Answer>,
    /// Outcome.
    pub outcome: Outcome,
}

/// An answer of a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Answer {
    /// The seed that was sent.
    pub seed: Option<u64>,
    /// The temperature that was sent.
    pub temperature: Option<f64>,
    /// Text.
    pub text: String,
    /// Reason for its end, such as `stop` or `length`.
    pub finish_reason: Option<String>,
    /// Name of the model on the server.
    pub model: Option<String>,
    /// Tokens, if counted by the server.
    pub usage: Option<Usage>,
    /// HTTP requests sent.
    pub attempts: u32,
    /// Why it is unusable.
    pub problem: Option<String>,
}

/// Outcome of a question.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// A success score.
    Success(SuccessScore),
    /// Rubric scores.
    Rubric(RubricScores),
    /// No usable answer, with the fault of the last one.
    Unusable(String),
    /// An error; the question is sent again after reopening.
    Interrupted(String),
}
