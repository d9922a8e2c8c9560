//! The current status as JSON: rates, nodes, executor, and missing inputs.

use crate::{
    diagnostics::NodeJson,
    executor::Executor,
    learner::Learner,
    state::{State, Topic},
};
use serde::Serialize;
use wm_model::Fit;

/// A camera that is silent for this long is missing \[ns\].
const SILENT_NS: i64 = 3_000_000_000;

#[derive(Serialize)]
struct TopicJson<'a> {
    name: &'a str,
    hz: f64,
    count: u64,
    publishers: Option<usize>,
    age_ms: Option<i64>,
}

/// An input of the page that is missing.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub(crate) struct MissingInput {
    /// Its panel.
    panel: &'static str,
    /// The fault and the remedy.
    text: String,
}

/// A topic that the view subscribes to, or reads from a bag.
#[derive(Clone, Debug)]
pub(crate) struct InputTopic {
    /// Which.
    pub topic: Topic,
    /// Its absolute name.
    pub name: String,
    /// Number of publishers; `None` in a bag.
    pub publishers: Option<usize>,
}

/// Status that does not come from messages.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct View {
    pub clients: usize,
    /// Connections refused because there were too many.
    pub refused: u64,
}

#[derive(Serialize)]
struct Message<'a> {
    op: &'static str,
    now: String,
    topics: Vec<TopicJson<'a>>,
    nodes: Vec<NodeJson<'a>>,
    executor: Option<&'a Executor>,
    executor_age_ms: Option<i64>,
    learner: Option<&'a Learner>,
    missing: Vec<MissingInput>,
    fit: Fit,
    kept_bytes: usize,
    kept_s: f64,
    view: &'a View,
}

/// The message `status`.
pub(crate) fn message(state: &mut State, heard: &[InputTopic], view: &View, now_ns: i64) -> String {
    let missing = missing(state, heard, now_ns);
    let topics = heard.iter().map(|heard| {
        let rate = state.rate(heard.topic);
        TopicJson {
            name: &heard.name,
            hz: rate.hertz(now_ns),
            count: rate.count(),
            publishers: heard.publishers,
            age_ms: rate.age_ns(now_ns).map(|age_ns| age_ns / 1_000_000),
        }
    });
    let topics = topics.collect();
    let executor = state.executor.as_ref();
    let message = Message {
        op: "status",
        now: now_ns.to_string(),
        topics,
        nodes: state.nodes.json(now_ns),
        executor,
        executor_age_ms: executor.map(|executor| executor.age_ms(now_ns)),
        learner: state.learner.as_ref(),
        missing,
        fit: state.fit,
        kept_bytes: state.album.bytes(),
        kept_s: state.album.span_ns() as f64 / 1e9,
        view,
    };
    // texts and numbers: it cannot fail
    serde_json::to_string(&message).unwrap_or_default()
}

/// What is missing, for whoever wonders why a panel is empty.
fn missing(state: &mut State, heard: &[InputTopic], now_ns: i64) -> Vec<MissingInput> {
    let find = |topic: Topic| heard.iter().find(|heard| heard.topic == topic);
    let name = |topic: Topic| find(topic).map_or("", |heard| heard.name.as_str());
    let is_bag = |topic: Topic| find(topic).is_none_or(|heard| heard.publishers.is_none());
    let has_publisher = |topic: Topic| find(topic).is_some_and(|heard| heard.publishers > Some(0));
    let camera = name(Topic::Camera);
    let mut missing = Vec::new();
    let mut miss = |panel, text| missing.push(MissingInput { panel, text });
    let has_frames = state.rate(Topic::Camera).count() > 0;
    match (
        is_bag(Topic::Camera),
        state.rate(Topic::Camera).age_ns(now_ns),
    ) {
        (true, None) => miss(
            "camera",
            format!("the bag has no pictures on {camera} or {camera}/compressed: set camera_topic"),
        ),
        (false, None) if has_publisher(Topic::Camera) => {
            miss(
                "camera",
                format!("{camera} has a publisher, but no frame has come yet"),
            );
        }
        (false, None) => miss(
            "camera",
            format!(
                "no frame, and nobody publishes {camera} or {camera}/compressed: start a camera or a player, or set camera_topic"
            ),
        ),
        (false, Some(age_ns)) if age_ns > SILENT_NS => {
            miss(
                "camera",
                format!("the last frame came {} s ago", age_ns / 1_000_000_000),
            );
        }
        _ => {}
    }
    let has_predictions = state.rate(Topic::Predicted).count() > 0;
    let has_pictures = state.rate(Topic::Pictures).count() > 0;
    if !has_predictions {
        let text = if is_bag(Topic::Camera) {
            format!("the bag has no predictions ({})", name(Topic::Predicted))
        } else if !has_publisher(Topic::Predicted) {
            "no predictor is running".to_owned()
        } else if has_frames && state.rate(Topic::Action).count() == 0 {
            format!(
                "no prediction yet: no action has come on {}",
                name(Topic::Action)
            )
        } else {
            "no prediction yet: it takes the latents and actions of two model steps".to_owned()
        };
        miss("predicted", text);
    } else if !has_pictures {
        let text = if is_bag(Topic::Camera) || has_publisher(Topic::Pictures) {
            format!(
                "predictions come, but no pictures of them on {}",
                name(Topic::Pictures)
            )
        } else {
            "predictions come, but no decoder is running that makes pictures of them".to_owned()
        };
        miss("predicted", text);
    }
    if state.rate(Topic::Errors).count() == 0 {
        let text = if has_predictions {
            "no error yet: it takes the frame of the predicted time"
        } else {
            "no predictions yet, so no errors"
        };
        miss("error", text.to_owned());
    }
    if state.rate(Topic::Plan).count() == 0 {
        let text = if is_bag(Topic::Camera) {
            "the bag has no plans"
        } else if !state.nodes.has("planner") && !has_publisher(Topic::Plan) {
            "no planner is running"
        } else if state.rate(Topic::Goal).count() == 0 {
            "no plan: the planner has no goal"
        } else {
            "no plan yet"
        };
        miss("plan", text.to_owned());
    }
    missing
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{picture::Source, state::tests::prediction};

    fn heard(publishers: Option<usize>) -> Vec<InputTopic> {
        let topics = [
            (Topic::Camera, "/camera/image_raw"),
            (Topic::Predicted, "/wm/predicted"),
            (Topic::Pictures, "/wm/predicted/image"),
            (Topic::Action, "/wm/action"),
            (Topic::Plan, "/wm/plan"),
        ];
        let heard = |(topic, name): (Topic, &str)| InputTopic {
            topic,
            name: name.to_owned(),
            publishers,
        };
        topics.into_iter().map(heard).collect()
    }

    fn text_of<'a>(missing: &'a [MissingInput], panel: &str) -> &'a str {
        let found = missing.iter().find(|missing| missing.panel == panel);
        found.map_or("", |missing| &missing.text)
    }

    #[test]
    fn missing_inputs_are_named_until_they_arrive() {
        let mut state = State::live(1 << 20);
        let found = missing(&mut state, &heard(Some(0)), 0);
        assert!(
            text_of(&found, "camera").contains("/camera/image_raw"),
            "{found:?}"
        );
        assert_eq!(text_of(&found, "predicted"), "no predictor is running");
        let found = missing(&mut state, &heard(Some(1)), 0);
        assert!(
            text_of(&found, "camera").contains("no frame has come"),
            "{found:?}"
        );
        state.label(Source::Camera, 1, 1).unwrap();
        let found = missing(&mut state, &heard(Some(1)), 2);
        assert_eq!(text_of(&found, "camera"), "");
        assert!(
            text_of(&found, "predicted").contains("/wm/action"),
            "{found:?}"
        );
        state.prediction(&prediction(0, 1), 3).unwrap();
        let found = missing(&mut state, &heard(Some(0)), 4);
        assert!(
            text_of(&found, "predicted").contains("decoder"),
            "{found:?}"
        );
        let found = missing(&mut state, &heard(Some(1)), 20 * SILENT_NS);
        assert!(text_of(&found, "camera").contains("59 s ago"), "{found:?}");
        let found = missing(&mut State::of_bag(), &heard(None), 0);
        assert!(text_of(&found, "predicted").contains("the bag has no predictions"));
    }

    #[test]
    fn page_receives_the_models_fit() {
        let mut state = State::live(0);
        let fit = |state: &mut State| {
            let message = message(state, &heard(Some(1)), &View::default(), 0);
            let json: serde_json::Value = serde_json::from_str(&message).unwrap();
            json["fit"].as_str().unwrap().to_owned()
        };
        assert_eq!(
            fit(&mut state),
            "stretch",
            "until the decoder says otherwise"
        );
        let text = |data: &str| wm_msgs::std_msgs::String { data: data.into() };
        state.fit(&text("crop")).unwrap();
        assert_eq!(fit(&mut state), "crop");
        assert!(state.fit(&text("squeeze")).is_err());
        assert_eq!(fit(&mut state), "crop");
    }
}
