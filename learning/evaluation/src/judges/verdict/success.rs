use serde::{Deserialize, Serialize};

use super::{VerdictError, without_reasoning};
use crate::judges::excerpt::{excerpt, excerpt_of_end};

/// Least score of a success (the paper).
pub const SUCCESS_THRESHOLD: f64 = 0.5;

/// Degree of success of a rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "f64", into = "f64")]
pub enum SuccessScore {
    /// 0.
    Failure,
    /// 0.5.
    Partial,
    /// 1.
    Success,
}

impl SuccessScore {
    /// 0, 0.5 or 1.
    #[must_use]
    pub fn value(self) -> f64 {
        match self {
            Self::Failure => 0.0,
            Self::Partial => 0.5,
            Self::Success => 1.0,
        }
    }

    /// Whether it reaches [`SUCCESS_THRESHOLD`].
    #[must_use]
    pub fn is_success(self) -> bool {
        self.value() >= SUCCESS_THRESHOLD
    }
}

impl From<SuccessScore> for f64 {
    fn from(score: SuccessScore) -> Self {
        score.value()
    }
}

impl TryFrom<f64> for SuccessScore {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        let scores = [Self::Failure, Self::Partial, Self::Success];
        let found = scores.into_iter().find(|score| score.value() == value);
        found.ok_or_else(|| format!("the score is {value}, expected 0, 0.5 or 1"))
    }
}

/// Finds the score in an answer: the last line `Final Score: X`, whatever surrounds it. Markdown, a final period and
/// letter case do not matter; text between `<think>` and `</think>` is ignored. X is 0 or 1, or 0.5 if `partial`.
///
/// # Errors
/// If there is no such line, or the last one has another X; earlier lines do not count then.
pub fn parse_success(answer: &str, partial: bool) -> Result<SuccessScore, VerdictError> {
    let answer = without_reasoning(answer)?;
    let found = answer.lines().rev().find_map(value_of_line);
    let Some(found) = found else {
        return Err(VerdictError::NoScore {
            excerpt: excerpt_of_end(answer),
        });
    };
    let score = decimal(&found).and_then(|value| SuccessScore::try_from(value).ok());
    score
        .filter(|score| partial || *score != SuccessScore::Partial)
        .ok_or_else(|| VerdictError::Score {
            found: excerpt(&found),
            expected: if partial { "0, 0.5 or 1" } else { "0 or 1" },
        })
}

/// The text after `Final Score:`, if the line starts so.
fn value_of_line(line: &str) -> Option<String> {
    // Emphasis may be anywhere: **Final Score:** 1.
    let plain: String = line.chars().filter(|c| !"*_`".contains(*c)).collect();
    // Headings, quotes, lists.
    let plain = plain.trim_start_matches(|c: char| c.is_whitespace() || "#>-•".contains(c));
    let rest = strip_word(plain, "final")?;
    let rest = strip_word(rest.trim_start(), "score")?;
    // The second colon is written by models that reason in Chinese.
    let value = rest.trim_start().strip_prefix([':', '：'])?.trim();
    Some(value.strip_suffix(['.', '。']).unwrap_or(value).to_owned())
}

fn strip_word<'a>(text: &'a str, word: &str) -> Option<&'a str> {
    let (start, rest) = text.split_at_checked(word.len())?;
    start.eq_ignore_ascii_case(word).then_some(rest)
}

/// A number without sign or exponent.
fn decimal(text: &str) -> Option<f64> {
    let plain = text.chars().all(|c| c.is_ascii_digit() || c == '.');
    if plain { text.parse().ok() } else { None }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{SuccessScore::*, *};

    #[test]
    fn last_line_with_a_score_counts() {
        let cases = [
            ("Final Score: 1", Success),
            ("It is closed.\nFinal Score: 0\n", Failure),
            ("**Final Score: 1**", Success),
            ("**Final Score:** 1.0", Success),
            ("### Final Score: 0.0.", Failure),
            ("- `final score : 1`\r\n\r\nThank you.", Success),
            ("> Final Score：1。", Success),
            (
                "Final Score: 1\nOn second thought:\nFinal Score: 0",
                Failure,
            ),
            ("<think>\nFinal Score: 1\n</think>\nFinal Score: 0", Failure),
            ("So I answer\nFinal Score: 1</think>Final Score: 0", Failure),
            ("Final Score: 0.50", Partial),
        ];
        for (answer, score) in cases {
            assert_eq!(parse_success(answer, true), Ok(score), "{answer}");
        }
    }

    #[test]
    fn other_texts_have_no_score() {
        let cases = [
            "",
            "The robot closes the oven.",
            "I give Final Score: 1",
            "Final Score 1",
            "<think>\nFinal Score: 1\nbut wait",
            "\u{212a}inal Score: 1",
        ];
        for answer in cases {
            let error = parse_success(answer, true).unwrap_err();
            assert!(
                matches!(error, VerdictError::NoScore { .. }),
                "{answer}: {error}"
            );
        }
        let found = [
            "X", "", "2", "-1", "+1", "1e0", "0.7", "1/1", "0 or 1", "inf", ".",
        ];
        for found in found {
            let answer = format!("Final Score: 1\nFinal Score: {found}");
            let error = parse_success(&answer, true).unwrap_err();
            assert!(
                matches!(error, VerdictError::Score { .. }),
                "{answer}: {error}"
            );
        }
        let long = format!(
            "{}\nFinal Score: 1",
            "a".repeat(super::super::MAX_ANSWER_BYTES)
        );
        assert!(matches!(
            parse_success(&long, true),
            Err(VerdictError::TooLong { .. })
        ));
    }

    #[test]
    fn half_a_success_must_be_requested() {
        assert_eq!(parse_success("Final Score: 0.5", true), Ok(Partial));
        let error = parse_success("Final Score: 0.5", false).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the final score is \"0.5\", expected 0 or 1"
        );
        assert!(Partial.is_success() && Success.is_success() && !Failure.is_success());
    }

    #[test]
    fn scores_are_numbers_in_files() {
        let written = serde_json::to_string(&[Failure, Partial, Success]).unwrap();
        assert_eq!(written, "[0.0,0.5,1.0]");
        let read: Vec<SuccessScore> = serde_json::from_str("[0, 0.5, 1]").unwrap();
        assert_eq!(read, [Failure, Partial, Success]);
        assert!(serde_json::from_str::<SuccessScore>("0.7").is_err());
    }

    proptest! {
        #[test]
        fn no_text_panics(answer in "(?s).{0,200}", partial: bool) {
            parse_success(&answer, partial).ok();
        }

        #[test]
        fn no_line_panics(value in "(?i)[*_# ]{0,3}(final|fınal)? ?(score)?[ :]{0,3}[-+0-9.eE*x]{0,8}") {
            parse_success(&value, true).ok();
        }

        #[test]
        fn score_is_found_in_any_noise(
            before in "(?s).{0,200}",
            after in "(?s).{0,200}",
            line in prop::sample::select(vec!["Final Score: 1", "**Final Score: 1**", "final score: 1.0."]),
        ) {
            let noise = |text: &str| text.contains("think>") || text.to_lowercase().contains("final");
            prop_assume!(!noise(&before) && !noise(&after));
            let answer = format!("{before}\n{line}\n{after}");
            prop_assert_eq!(parse_success(&answer, false), Ok(Success));
        }
    }
}
