//! The protocol of policy programs: JSON lines on standard input (requests) and output (answers).
//!
//! A request: `{"version": 1, "task": "episode_7", "trial": 0, "seed": 81, "step": 0, "instruction": "open the drawer",
//! "image": "...", "views": 1, "state": null, "action_space": {"name": "bridge_v2", "rate": 5.0, "actions_per_step": 2,
//! "names": ["dx", ...], "units": ["m", ...], "kinds": ["translation_delta", ...]}}`. The image is a PNG in base64 of the
//! model's size; several cameras are side by side. `state` is null: an imagined robot has no joints.
//!
//! An answer: `{"action": [0.01, 0, 0, 0, 0, 0, 1]}`, `{"actions": [[...], [...]]}` or `{"error": "reason"}`. Actions are in
//! the units and at the rate of the action space: `actions_per_step` of them lead to the next image. All actions of an
//! answer are executed before the next request; the last one is held to fill the last model step.
//!
//! Requests of several episodes alternate: a policy must keep its state per `task`, `trial` and `instruction`, and should
//! draw random numbers from `seed` and `step`.

use anyhow::{Context as _, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use wm_motion::actions::{ActionEncoding, ActionSpace, Kind};

/// The version of the protocol.
pub const VERSION: u32 = 1;
/// Most actions of an answer: more than any episode takes.
const MAX_ACTIONS: usize = 10_000;
/// Characters quoted of an invalid answer.
const MAX_QUOTE: usize = 200;

/// A request to the policy.
#[derive(Clone, Debug, Serialize)]
pub struct Request<'a> {
    /// [`VERSION`].
    pub version: u32,
    /// Name of the task.
    pub task: &'a str,
    /// Trial, from 0.
    pub trial: usize,
    /// Seed of the trial, below 2^53.
    pub seed: u64,
    /// Model steps so far.
    pub step: usize,
    /// Instruction for the robot.
    pub instruction: &'a str,
    /// A PNG in base64.
    pub image: String,
    /// Number of cameras, side by side in the image.
    pub views: usize,
    /// Always null.
    pub state: Option<()>,
    /// Description of the actions.
    pub action_space: &'a ActionSpaceInfo<'a>,
}

/// Description of the actions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ActionSpaceInfo<'a> {
    /// The space's name.
    pub name: &'a str,
    /// Actions per second.
    pub rate: f64,
    /// Actions per image.
    pub actions_per_step: usize,
    /// By value.
    pub names: Vec<&'a str>,
    /// By value.
    pub units: Vec<&'a str>,
    /// By value.
    pub kinds: Vec<Kind>,
}

impl<'a> ActionSpaceInfo<'a> {
    /// The space of a model.
    #[must_use]
    pub fn of(encoding: &'a ActionEncoding) -> Self {
        let space = encoding.space();
        let dimensions = space.dimensions().iter();
        Self {
            name: space.name(),
            rate: space.rate(),
            actions_per_step: encoding.frame_skip(),
            names: dimensions.clone().map(|d| &*d.name).collect(),
            units: dimensions.clone().map(|d| &*d.unit).collect(),
            kinds: dimensions.map(|d| d.kind).collect(),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Answer {
    action: Option<Vec<f32>>,
    actions: Option<Vec<Vec<f32>>>,
    error: Option<String>,
}

/// The actions of an answer, at least one.
///
/// # Errors
/// For an invalid answer, an error of the policy, or implausible values.
pub fn actions(line: &str, space: &ActionSpace) -> Result<Vec<Vec<f32>>> {
    let answer: Answer = serde_json::from_str(line).with_context(|| {
        format!(
            "expected {{\"action\": [..]}}, {{\"actions\": [[..], ..]}} or {{\"error\": \"..\"}}, got {}",
            excerpt(line)
        )
    })?;
    let actions = match answer {
        Answer {
            error: Some(why), ..
        } => bail!("the policy reports: {}", excerpt(&why)),
        Answer {
            action: Some(action),
            actions: None,
            ..
        } => vec![action],
        Answer {
            action: None,
            actions: Some(actions),
            ..
        } => actions,
        _ => bail!(
            "expected either \"action\" or \"actions\", got {}",
            excerpt(line)
        ),
    };
    ensure!(
        (1..=MAX_ACTIONS).contains(&actions.len()),
        "expected 1 to {MAX_ACTIONS} actions, got {}",
        actions.len()
    );
    for (number, action) in actions.iter().enumerate() {
        let checked = space.check(action);
        checked.with_context(|| format!("action {number}"))?;
    }
    Ok(actions)
}

/// The beginning of a program's text, escaped for a terminal.
pub(super) fn excerpt(text: &str) -> String {
    let mut quoted: String = text.trim_end().escape_debug().take(MAX_QUOTE).collect();
    if quoted.len() < text.trim_end().len() {
        quoted.push_str("...");
    }
    format!("`{quoted}`")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use proptest::prelude::*;

    use super::*;

    const GOOD: &str = "[0.01, 0, 0, 0, 0, 0, 1]";

    fn parse(line: &str) -> Result<Vec<Vec<f32>>> {
        actions(line, &ActionSpace::bridge())
    }

    #[test]
    fn one_or_several_actions_are_parsed() {
        let one = parse(&format!("{{\"action\": {GOOD}}}\n")).unwrap();
        assert_eq!(one, [[0.01, 0., 0., 0., 0., 0., 1.]]);
        let two = parse(&format!(
            "{{\"actions\": [{GOOD}, {GOOD}], \"error\": null}}"
        ))
        .unwrap();
        assert_eq!(two.len(), 2);
    }

    #[test]
    fn other_answers_are_rejected_by_name() {
        for (line, named) in [
            ("", "expected {\"action\""),
            ("\u{1b}[2Jloading", "got `\\u{1b}[2Jloading`"),
            ("[0, 0]", "expected {\"action\""),
            ("{}", "either"),
            (r#"{"action": [0], "actions": []}"#, "either"),
            (r#"{"actions": []}"#, "expected 1 to 10000 actions, got 0"),
            (r#"{"action": [0, 0]}"#, "action 0"),
            (r#"{"action": [NaN, 0, 0, 0, 0, 0, 0]}"#, "got `"),
            (r#"{"action": [1e300, 0, 0, 0, 0, 0, 0]}"#, "value 0"),
            (r#"{"action": [50, 0, 0, 0, 0, 0, 0]}"#, "dx"),
            (r#"{"actions": [[0, 0, 0, 0, 0, 0, 1], [0]]}"#, "action 1"),
            (
                r#"{"error": "no \u001b[2J GPU"}"#,
                "the policy reports: `no \\u{1b}[2J GPU`",
            ),
            (r#"{"act": [0]}"#, "act"),
        ] {
            let error = format!("{:#}", parse(line).unwrap_err());
            assert!(error.contains(named), "{line}: {error}");
        }
        let long = parse(&"x".repeat(100_000)).unwrap_err().to_string();
        assert!(long.len() < 500 && long.contains("..."), "{long}");
    }

    #[test]
    fn space_has_names_units_and_kinds() {
        let encoding = ActionEncoding::default();
        let json = serde_json::to_value(ActionSpaceInfo::of(&encoding)).unwrap();
        assert_eq!(json["names"][3], "droll");
        assert_eq!(json["units"][3], "rad");
        assert_eq!(json["kinds"][6], "gripper_binary");
        assert_eq!(json["actions_per_step"], 2);
    }

    proptest! {
        #[test]
        fn no_line_panics(line in "(?s).{0,200}", json in "[{}\\[\\]\",:actionserror0-9.eE+-]{0,100}") {
            parse(&line).ok();
            parse(&json).ok();
        }

        #[test]
        fn actions_round_trip(values in prop::collection::vec(prop::array::uniform7(-0.4_f32..0.4), 1..5)) {
            let line = serde_json::json!({"actions": values}).to_string();
            let values: Vec<Vec<f32>> = values.iter().map(|v| v.to_vec()).collect();
            prop_assert_eq!(parse(&line).unwrap(), values);
        }
    }
}
