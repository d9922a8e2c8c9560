use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::judges::{
    endpoint::Usage,
    verdict::{RubricScores, SuccessScore},
};

/// A question and what came of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Hash of all that decides of the answer: the judge's name, the model, the prompt, the frames, how they are sent, the
    /// sampling and the trial.
    pub key: String,
    /// The rollout's, as the caller gave it.
    pub stamp_ns: u64,
    /// The judge's name.
    pub judge: String,
    /// The rollout's instruction.
    pub instruction: String,
    /// Which of the rollouts with this instruction.
    pub trial: u64,
    /// Which frames of the video it saw, counted from 0.
    pub frames: Vec<usize>,
    /// What was sent first, with the hashes of the frames' pixels in place of the pictures.
    pub request: Value,
    /// All answers; the verdict is that of the last.
    pub answers: Vec<Answer>,
    /// What came of it.
    pub outcome: Outcome,
}

/// What a model said.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Answer {
    /// The seed that was sent.
    pub seed: Option<u64>,
    /// The temperature that was sent.
    pub temperature: Option<f64>,
    /// Its words.
    pub text: String,
    /// Why it ended, as `stop` or `length`.
    pub finish_reason: Option<String>,
    /// What the server calls the model.
    pub model: Option<String>,
    /// Tokens, if the server counts them.
    pub usage: Option<Usage>,
    /// HTTP requests that it took.
    pub attempts: u32,
    /// Why it is no verdict.
    pub problem: Option<String>,
}

/// What came of a question.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// How far the rollout got.
    Success(SuccessScore),
    /// The rubric's scores.
    Rubric(RubricScores),
    /// No answer is a verdict, and why the last is not.
    Unusable(String),
    /// An error came between; the question is asked again when the record is opened again.
    Interrupted(String),
}
