use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{VerdictError, without_reasoning};
use crate::judges::excerpt::{excerpt, excerpt_of_end};

/// The keys of a rubric's object.
pub const RUBRIC_KEYS: [&str; 3] = [
    "Interaction_Quality",
    "Perspectivity",
    "Instruction_Following",
];

/// A score of the rubric.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rating {
    /// 1 to 5.
    pub score: u8,
    /// Reason given by the judge.
    pub reason: String,
}

/// The three scores of the rubric.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RubricScores {
    /// Plausibility of the contact between robot and objects.
    #[serde(rename = "Interaction_Quality")]
    pub interaction_quality: Rating,
    /// Spatial consistency.
    #[serde(rename = "Perspectivity")]
    pub perspectivity: Rating,
    /// Completion of the instruction.
    #[serde(rename = "Instruction_Following")]
    pub instruction_following: Rating,
}

/// Finds the scores in an answer: the last JSON object with one of [`RUBRIC_KEYS`], whatever surrounds it, such as a
/// Markdown fence. It must have exactly these keys, each with an integer `score` from 1 to 5 and a text `reason`. Text
/// between `<think>` and `</think>` is ignored.
///
/// # Errors
/// If there is no such object, or the last one is invalid.
pub fn parse_rubric(answer: &str) -> Result<RubricScores, VerdictError> {
    let Some(mut object) = last_object(without_reasoning(answer)?) else {
        return Err(VerdictError::NoObject {
            excerpt: excerpt_of_end(answer),
        });
    };
    let right_keys = RUBRIC_KEYS.iter().all(|key| object.contains_key(*key));
    if !right_keys || object.len() != RUBRIC_KEYS.len() {
        // A few more than expected, to show the difference.
        let found = object.keys().take(2 * RUBRIC_KEYS.len());
        return Err(VerdictError::Keys {
            found: found.map(|key| excerpt(key)).collect(),
        });
    }
    let [quality, perspectivity, following] = RUBRIC_KEYS.map(|key| rating(key, &mut object));
    Ok(RubricScores {
        interaction_quality: quality?,
        perspectivity: perspectivity?,
        instruction_following: following?,
    })
}

/// The last object with a key of the rubric, or else the last one. An answer of n bytes takes at most 128 n steps; 128
/// is the depth limit of serde_json.
fn last_object(text: &str) -> Option<Map<String, Value>> {
    let mut last = None;
    let mut rest = text;
    while let Some(start) = rest.find('{') {
        rest = rest.get(start..).unwrap_or_default();
        let mut objects = serde_json::Deserializer::from_str(rest).into_iter();
        let Some(Ok(object)) = objects.next() else {
            rest = rest.get(1..).unwrap_or_default();
            continue;
        };
        rest = rest.get(objects.byte_offset()..).unwrap_or_default();
        let rated =
            |object: &Map<String, Value>| RUBRIC_KEYS.iter().any(|key| object.contains_key(*key));
        if rated(&object) || !last.as_ref().is_some_and(rated) {
            last = Some(object);
        }
    }
    last
}

fn rating(key: &'static str, object: &mut Map<String, Value>) -> Result<Rating, VerdictError> {
    // A missing rating is null, which no rating accepts.
    let value = object.remove(key).unwrap_or_default();
    let found = excerpt(&value.to_string());
    let rating = serde_json::from_value::<Rating>(value).ok();
    rating
        .filter(|rating| (1..=5).contains(&rating.score))
        .ok_or(VerdictError::Rating { key, found })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const GOOD: &str = r#"{"Interaction_Quality": {"score": 4, "reason": "a {firm} grasp"},
        "Perspectivity": {"score": 5, "reason": ""},
        "Instruction_Following": {"score": 2, "reason": "human hands"}}"#;

    fn scores(answer: &str) -> [u8; 3] {
        let scores = parse_rubric(answer).unwrap();
        [
            scores.interaction_quality.score,
            scores.perspectivity.score,
            scores.instruction_following.score,
        ]
    }

    #[test]
    fn object_is_found_anywhere() {
        let worse = GOOD.replace('4', "1");
        let answers = [
            GOOD.to_owned(),
            format!("```json\n{GOOD}\n```"),
            format!("The {{robot}} closes {{\"it\": 1}}. {GOOD} Done {{}}."),
            format!("<think>{worse}</think>{GOOD}"),
            format!("{worse}\nNo:\n{GOOD}"),
        ];
        for answer in answers {
            assert_eq!(scores(&answer), [4, 5, 2], "{answer}");
        }
    }

    #[test]
    fn faulty_objects_are_rejected_by_name() {
        let cases = [
            (
                GOOD.replace("\"score\": 4", "\"score\": 6"),
                "Interaction_Quality is {\"",
            ),
            (GOOD.replace("\"score\": 4", "\"score\": 0"), "1 to 5"),
            (GOOD.replace("\"score\": 4", "\"score\": 4.5"), "1 to 5"),
            (GOOD.replace("\"score\": 4", "\"score\": \"4\""), "1 to 5"),
            (
                GOOD.replace("\"reason\": \"\"", "\"reason\": null"),
                "Perspectivity is",
            ),
            (GOOD.replace(", \"reason\": \"\"", ""), "Perspectivity is"),
            (GOOD.replace("Perspectivity", "Perspective"), "Perspective"),
            (GOOD.replacen('{', "{\"Overall\": 3, ", 1), "Overall"),
            (GOOD.replace("}}", "}"), "expected [\"Interaction_Quality\""),
            ("Interaction_Quality: 4".to_owned(), "no JSON object"),
            (format!("<think>{GOOD}"), "no JSON object"),
        ];
        for (answer, named) in cases {
            let error = parse_rubric(&answer).unwrap_err().to_string();
            assert!(error.contains(named), "{answer}: {error}");
        }
    }

    #[test]
    fn deep_nesting_ends() {
        let deep = "{\"a\":[".repeat(20_000);
        assert!(parse_rubric(&deep).is_err());
        assert_eq!(scores(&format!("{deep}{GOOD}")), [4, 5, 2]);
    }

    proptest! {
        #[test]
        fn no_text_panics(answer in "(?s).{0,200}", json in "[{}\\[\\]\",:a-z0-9 ]{0,100}") {
            parse_rubric(&answer).ok();
            parse_rubric(&json).ok();
        }

        #[test]
        fn object_is_found_in_any_noise(before in "(?s).{0,200}", after in "(?s).{0,200}") {
            // An open brace before the object could swallow it.
            prop_assume!(!before.contains("think>") && !after.contains("think>"));
            let answer = format!("{before}\n{GOOD}\n{after}");
            prop_assert_eq!(scores(&answer), [4, 5, 2]);
        }
    }
}
