//! Verdicts in answers.

mod rubric;
mod success;

pub use rubric::{RUBRIC_KEYS, Rating, RubricScores, parse_rubric};
pub use success::{SUCCESS_THRESHOLD, SuccessScore, parse_success};

/// Longest answer that is searched for a score \[bytes\].
pub const MAX_ANSWER_BYTES: usize = 1 << 20;

/// An unusable answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum VerdictError {
    /// A missing score line.
    #[error("no line \"Final Score: X\" in the answer: {excerpt}")]
    NoScore {
        /// End of the answer.
        excerpt: String,
    },
    /// An invalid score.
    #[error("the final score is \"{found}\", expected {expected}")]
    Score {
        /// Text of the score.
        found: String,
        /// Accepted scores.
        expected: &'static str,
    },
    /// A missing JSON object.
    #[error("no JSON object in the answer: {excerpt}")]
    NoObject {
        /// End of the answer.
        excerpt: String,
    },
    /// An object with other keys.
    #[error("the object has the keys {found:?}, expected {RUBRIC_KEYS:?}")]
    Keys {
        /// The first few keys.
        found: Vec<String>,
    },
    /// An invalid rating.
    #[error("{key} is {found}, expected {{\"score\": 1 to 5, \"reason\": \"...\"}}")]
    Rating {
        /// Key of the rating.
        key: &'static str,
        /// Value.
        found: String,
    },
    /// An answer that is too long.
    #[error("the answer has {bytes} bytes, expected at most {MAX_ANSWER_BYTES}")]
    TooLong {
        /// Length \[bytes\].
        bytes: usize,
    },
    /// An answer cut off by the server; even its last line may be incomplete.
    #[error("the answer was cut off at max_tokens, expected a whole one; it ends: {excerpt}")]
    CutOff {
        /// End of the answer.
        excerpt: String,
    },
}

/// The answer without reasoning: after the last `</think>`, and up to an unclosed `<think>`. Reasoning quotes the form
/// of the answer, and mentions scores that it dismisses.
fn without_reasoning(text: &str) -> Result<&str, VerdictError> {
    if text.len() > MAX_ANSWER_BYTES {
        return Err(VerdictError::TooLong { bytes: text.len() });
    }
    let text = text
        .rsplit_once("</think>")
        .map_or(text, |(_, after)| after);
    Ok(text
        .split_once("<think>")
        .map_or(text, |(before, _)| before))
}
