//! What an answer says.

mod rubric;
mod success;

pub use rubric::{RUBRIC_KEYS, Rating, RubricScores, parse_rubric};
pub use success::{SUCCESS_THRESHOLD, SuccessScore, parse_success};

/// An answer longer than this, in bytes, is not searched for a score.
pub const MAX_ANSWER_BYTES: usize = 1 << 20;

/// Why an answer is no verdict.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum VerdictError {
    /// There is no line with a score.
    #[error("no line \"Final Score: X\" in the answer: {excerpt}")]
    NoScore {
        /// The answer's end.
        excerpt: String,
    },
    /// The line has something else.
    #[error("the final score is \"{found}\", expected {expected}")]
    Score {
        /// What the line has.
        found: String,
        /// What it may have.
        expected: &'static str,
    },
    /// There is no JSON object.
    #[error("no JSON object in the answer: {excerpt}")]
    NoObject {
        /// The answer's end.
        excerpt: String,
    },
    /// The object has other keys than it should.
    #[error("the object has the keys {found:?}, expected {RUBRIC_KEYS:?}")]
    Keys {
        /// Its keys, the first few.
        found: Vec<String>,
    },
    /// A rating is not one.
    #[error("{key} is {found}, expected {{\"score\": 1 to 5, \"reason\": \"...\"}}")]
    Rating {
        /// Which.
        key: &'static str,
        /// What it is.
        found: String,
    },
    /// The answer is too long.
    #[error("the answer has {bytes} bytes, expected at most {MAX_ANSWER_BYTES}")]
    TooLong {
        /// Its length.
        bytes: usize,
    },
    /// The server cut the answer off, so that even its last line may be half of one.
    #[error("the answer was cut off at max_tokens, expected a whole one; it ends: {excerpt}")]
    CutOff {
        /// The answer's end.
        excerpt: String,
    },
}

/// The answer without what the model thought before it: up to the last `</think>`, and from a `<think>` that was never
/// closed. Thoughts quote the form of the answer, and weigh scores that they then dismiss.
fn spoken(text: &str) -> Result<&str, VerdictError> {
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
