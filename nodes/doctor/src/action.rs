//! The robot's actions.

use crate::{Actions, Finding, Heard, ModelFacts, camera, heard::DEFAULT_ACTION};
use std::time::Duration;
use wm_model_nodes::cadence::hertz;
use wm_ros::{Reliability, logging::of_others};

/// This check.
const CHECK: &str = "action";
/// Stamps of frames and actions that are further apart are of two clocks, or one is not of the moment \[s\].
const APART_S: f64 = 1.0;

/// What is to be said of the actions that the nodes would use.
pub(crate) fn check(
    heard: &Heard,
    camera: Option<&str>,
    wanted: Option<&str>,
    model: Option<&ModelFacts>,
) -> Vec<Finding> {
    let Some((name, actions)) = heard.actions(wanted) else {
        return vec![absent(heard, wanted)];
    };
    let shown = of_others(name);
    let stream = &actions.stream;
    let mut findings = Vec::new();
    if stream
        .publishers
        .iter()
        .any(|qos| qos.reliability == Reliability::BestEffort)
    {
        findings.push(
            Finding::error(CHECK, format!("{shown} is offered best effort"))
                .because("the nodes ask for reliable delivery, so they are not connected: a lost action is a motion that nobody knows of")
                .fix(format!("publish it reliable, or -p qos_overrides.{shown}.subscription.reliability:=best_effort on predictor, planner and evaluator")),
        );
    }
    if let Some(finding) = camera::bad_times(&shown, stream) {
        findings.push(Finding {
            check: CHECK.into(),
            ..finding
        });
    }
    if stream.timeline.is_empty() && stream.bad_times == 0 {
        findings.push(
            Finding::note(CHECK, format!("{shown} has a publisher, and nothing came"))
                .because(
                    "an arm that stands still may publish nothing; the last action is then held",
                )
                .fix("move the arm and look again"),
        );
    }
    if stream.timeline.is_empty() {
        return findings;
    }
    let rate = match stream.timeline.period_s() {
        Some(period_s) => hertz(Duration::from_secs_f64(period_s)),
        None => format!("{} messages", stream.timeline.len()),
    };
    if actions.is_chunk {
        let what = format!("{shown} has action chunks, what a policy means to do");
        findings.push(
            Finding::error(CHECK, what)
                .because("what was done is told by single actions (wm_msgs/Action)")
                .fix("name the topic of the actions with --action; remap /wm/action_chunk to this one"),
        );
        return findings;
    }
    let width = actions.values.first().map_or(0, Vec::len);
    findings.push(Finding::ok(
        CHECK,
        format!("{shown}: {width} values, {rate}"),
    ));
    findings.extend(fit(&shown, actions, model));
    findings.extend(stamped_with(&shown, actions, heard, camera));
    if name != DEFAULT_ACTION {
        findings.push(
            Finding::note(
                CHECK,
                format!("{shown} is not the nodes' default, {DEFAULT_ACTION}"),
            )
            .fix(format!(
                "wm launch launch-configs/live.launch.yaml action:={shown}, or wm init DIR"
            )),
        );
    }
    findings
}

fn absent(heard: &Heard, wanted: Option<&str>) -> Finding {
    let what = match wanted {
        Some(name) => format!("nobody publishes actions on {}", of_others(name)),
        None => "no actions (wm_msgs/Action)".to_owned(),
    };
    let why = "predictions then go on as if the arm stood still, and misses of it count as errors of the model";
    let fix = match heard.motions.first() {
        Some(motion) => format!(
            "wm init DIR --action {}, which starts the action adapter for it (docs/arm.md)",
            of_others(&motion.topic)
        ),
        None => "have the driver publish each action that it takes as wm_msgs/Action, or its velocities, poses or tf for wm action_adapter (docs/arm.md)".to_owned(),
    };
    Finding::warning(CHECK, what).because(why).fix(fix)
}

/// Whether the values are those that the model was trained on.
fn fit(name: &str, actions: &Actions, model: Option<&ModelFacts>) -> Vec<Finding> {
    let Some(space) = model.and_then(|model| model.action_space.as_ref()) else {
        return Vec::new();
    };
    let wrong = actions
        .values
        .iter()
        .find_map(|values| space.check(values).err());
    let finding = |error| {
        Finding::error(CHECK, format!("{name}: {error}"))
            .because("the nodes refuse such actions (malformed_action)")
            .fix("publish what the model was trained on, in m and rad, or train one on these actions (wm bag import --action-space FILE, wm train model)")
    };
    wrong.map(finding).into_iter().collect()
}

/// Whether actions and frames are stamped by the same clock.
fn stamped_with(
    name: &str,
    actions: &Actions,
    heard: &Heard,
    camera: Option<&str>,
) -> Option<Finding> {
    let unstamped = actions.stream.timeline.unstamped();
    if unstamped > 0 {
        return Some(
            Finding::error(
                CHECK,
                format!("{name}: {unstamped} messages have no valid stamp"),
            )
            .because("frames and actions are matched by their stamps")
            .fix("stamp each action with the moment at which it is taken"),
        );
    }
    let camera = heard.camera(camera)?.1.best()?;
    let apart_s = actions.stream.timeline.delay_s()? - camera.timeline.delay_s()?;
    let finding = || {
        Finding::warning(CHECK, format!("{name}: stamps of actions and frames are {:.1} s apart", apart_s.abs()))
            .because("an action is matched with the frames of its stamp, here those of another moment")
            .fix("stamp both by one clock: synchronise the machines, and stamp actions when they are taken")
    };
    (apart_s.abs() > APART_S).then(finding)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, Level, Motion, Stream, fit::facts, timeline::regular};
    use wm_ros::Qos;

    fn heard(qos: Qos, delay_ms: i64, values: Vec<f32>) -> Heard {
        let stream = |delay_ms| Stream {
            timeline: regular(9, 100, delay_ms),
            publishers: vec![qos],
            ..Stream::default()
        };
        let mut heard = Heard::default();
        let actions = Actions {
            stream: stream(delay_ms),
            values: vec![values],
            ..Actions::default()
        };
        heard.actions.insert(DEFAULT_ACTION.into(), actions);
        let camera = Camera {
            raw: Some(stream(10)),
            ..Camera::default()
        };
        heard.cameras.insert("/camera/image_raw".into(), camera);
        heard
    }

    fn levels(heard: &Heard) -> Vec<Level> {
        let found = check(heard, None, None, Some(&facts()));
        found.iter().map(|finding| finding.level).collect()
    }

    #[test]
    fn good_actions_are_one_line() {
        let heard = heard(Qos::reliable(10), 5, vec![0.0; 7]);
        let found = check(&heard, None, None, Some(&facts()));
        assert_eq!(found, [Finding::ok(CHECK, "/wm/action: 7 values, 10 Hz")]);
    }

    #[test]
    fn actions_with_invalid_times_are_an_error() {
        let mut invalid = heard(Qos::reliable(10), 5, vec![0.0; 7]);
        for actions in invalid.actions.values_mut() {
            actions.stream.bad_times = 3;
        }
        assert_eq!(levels(&invalid), [Level::Error, Level::Ok]);
        for actions in invalid.actions.values_mut() {
            actions.stream.timeline = regular(0, 100, 5);
        }
        assert_eq!(levels(&invalid), [Level::Error]);
    }

    #[test]
    fn what_the_nodes_would_not_take_is_an_error() {
        let best_effort = heard(Qos::best_effort(10), 5, vec![0.0; 7]);
        assert_eq!(levels(&best_effort), [Level::Error, Level::Ok]);
        let eight = heard(Qos::reliable(10), 5, vec![0.0; 8]);
        assert_eq!(levels(&eight), [Level::Ok, Level::Error]);
        // Millimetres.
        let large = heard(
            Qos::reliable(10),
            5,
            vec![50.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        );
        assert_eq!(levels(&large), [Level::Ok, Level::Error]);
    }

    #[test]
    fn two_clocks_are_told() {
        let apart = heard(Qos::reliable(10), 3_000, vec![0.0; 7]);
        assert_eq!(levels(&apart), [Level::Ok, Level::Warning]);
    }

    #[test]
    fn an_arm_that_publishes_something_else_has_an_adapter() {
        let mut heard = Heard::default();
        let fix = |heard: &Heard| check(heard, None, None, None)[0].fix.clone().unwrap();
        assert!(fix(&heard).contains("docs/arm.md"));
        heard.motions.push(Motion {
            topic: "/arm/twist".into(),
            type_name: "geometry_msgs/msg/TwistStamped".into(),
            source: "twist",
        });
        assert!(fix(&heard).contains("wm init DIR --action /arm/twist"));
    }
}
