//! What a policy's program is asked, and what it answers: a line of JSON each, on its standard input and output.
//!
//! The request: `{"version": 1, "task": "episode_7", "trial": 0, "seed": 81, "step": 0, "instruction": "open the drawer",
//! "image": "...", "views": 1, "state": null, "action_space": {"name": "bridge_v2", "rate": 5.0, "actions_per_step": 2,
//! "names": ["dx", ...], "units": ["m", ...], "kinds": ["translation_delta", ...]}}`. The image is a PNG in base64, of the
//! model's size; several cameras lie side by side. There is no state: an imagined robot has no joints.
//!
//! The answer: `{"action": [0.01, 0, 0, 0, 0, 0, 1]}`, `{"actions": [[...], [...]]}` or `{"error": "why not"}`. Actions are in
//! the units of the action space, at its rate: `actions_per_step` of them lead to the next image. Of a longer answer all are
//! carried out before the next request; where the last model step is not filled, its last action is held.
//!
//! Requests of several episodes alternate: what a policy remembers belongs to a `task` and a `trial` of which `instruction`
//! may differ too, and what it draws should come from `seed` and `step`.

use anyhow::{Context as _, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use wm_motion::actions::{ActionEncoding, ActionSpace, Kind};

/// The version of the protocol.
pub const VERSION: u32 = 1;
/// Most actions of an answer: more than any episode takes.
const MAX_ACTIONS: usize = 10_000;
/// Characters of a bad answer that an error quotes.
const QUOTED: usize = 200;

/// What a policy is asked.
#[derive(Clone, Debug, Serialize)]
pub struct Request<'a> {
    /// [`VERSION`].
    pub version: u32,
    /// The task's name.
    pub task: &'a str,
    /// The trial, from 0.
    pub trial: usize,
    /// The trial's seed, below 2^53.
    pub seed: u64,
    /// Model steps so far.
    pub step: usize,
    /// What the robot is told.
    pub instruction: &'a str,
    /// A PNG in base64.
    pub image: String,
    /// Cameras, side by side in the image.
    pub views: usize,
    /// Nothing.
    pub state: Option<()>,
    /// What the values of an action are.
    pub action_space: &'a SpaceOf<'a>,
}

/// What the values of an action are.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SpaceOf<'a> {
    /// The space's name.
    pub name: &'a str,
    /// Actions in a second.
    pub rate: f64,
    /// Actions that lead to the next image.
    pub actions_per_step: usize,
    /// Of each value.
    pub names: Vec<&'a str>,
    /// Of each value.
    pub units: Vec<&'a str>,
    /// Of each value.
    pub kinds: Vec<Kind>,
}

impl<'a> SpaceOf<'a> {
    /// That of a model.
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

/// The actions of an answer, of which there is at least one.
///
/// # Errors
/// If it is none, says why there are none, or has values that no robot moves by.
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
        } => bail!("it says: {}", excerpt(&why)),
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
        "{} actions, expected 1 to {MAX_ACTIONS}",
        actions.len()
    );
    for (number, action) in actions.iter().enumerate() {
        let checked = space.check(action);
        checked.with_context(|| format!("action {number}"))?;
    }
    Ok(actions)
}

/// The beginning of what a program wrote, fit for a terminal.
pub(super) fn excerpt(text: &str) -> String {
    let mut quoted: String = text.trim_end().escape_debug().take(QUOTED).collect();
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
    fn one_action_or_several() {
        let one = parse(&format!("{{\"action\": {GOOD}}}\n")).unwrap();
        assert_eq!(one, [[0.01, 0., 0., 0., 0., 0., 1.]]);
        let two = parse(&format!(
            "{{\"actions\": [{GOOD}, {GOOD}], \"error\": null}}"
        ))
        .unwrap();
        assert_eq!(two.len(), 2);
    }

    #[test]
    fn anything_else_is_refused_by_name() {
        for (line, named) in [
            ("", "expected {\"action\""),
            ("\u{1b}[2Jloading", "got `\\u{1b}[2Jloading`"),
            ("[0, 0]", "expected {\"action\""),
            ("{}", "either"),
            (r#"{"action": [0], "actions": []}"#, "either"),
            (r#"{"actions": []}"#, "0 actions, expected 1 to"),
            (r#"{"action": [0, 0]}"#, "action 0"),
            (r#"{"action": [NaN, 0, 0, 0, 0, 0, 0]}"#, "got `"),
            (r#"{"action": [1e300, 0, 0, 0, 0, 0, 0]}"#, "value 0"),
            (r#"{"action": [50, 0, 0, 0, 0, 0, 0]}"#, "dx"),
            (r#"{"actions": [[0, 0, 0, 0, 0, 0, 1], [0]]}"#, "action 1"),
            (
                r#"{"error": "no \u001b[2J GPU"}"#,
                "it says: `no \\u{1b}[2J GPU`",
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
    fn the_space_is_told_by_name_unit_and_kind() {
        let encoding = ActionEncoding::default();
        let told = serde_json::to_value(SpaceOf::of(&encoding)).unwrap();
        assert_eq!(told["names"][3], "droll");
        assert_eq!(told["units"][3], "rad");
        assert_eq!(told["kinds"][6], "gripper_binary");
        assert_eq!(told["actions_per_step"], 2);
    }

    proptest! {
        #[test]
        fn no_line_panics(line in "(?s).{0,200}", json in "[{}\\[\\]\",:actionserror0-9.eE+-]{0,100}") {
            parse(&line).ok();
            parse(&json).ok();
        }

        #[test]
        fn what_was_sent_arrives(values in prop::collection::vec(prop::array::uniform7(-0.4_f32..0.4), 1..5)) {
            let line = serde_json::json!({"actions": values}).to_string();
            let values: Vec<Vec<f32>> = values.iter().map(|v| v.to_vec()).collect();
            prop_assert_eq!(parse(&line).unwrap(), values);
        }
    }
}
