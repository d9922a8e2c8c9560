//! The robot's actions.

use crate::{Actions, Finding, ModelFacts, Survey, survey::DEFAULT_ACTION};
use std::time::Duration;
use wm_model_nodes::cadence::hertz;
use wm_ros::{Reliability, logging::of_others};

const CHECK: &str = "action";
/// Stamps of frames and actions that are further apart come from two clocks, or one is stale \[s\].
const APART_S: f64 = 1.0;

/// The findings about the actions that the nodes would use.
pub(crate) fn check(
    survey: &Survey,
    camera: Option<&str>,
    wanted: Option<&str>,
    model: Option<&ModelFacts>,
) -> Vec<Finding> {
    let Some((name, actions)) = survey.actions(wanted) else {
        return vec![absent(survey, wanted)];
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
            Finding::error(CHECK, format!("{shown} is best effort"))
                .because("the nodes request reliable delivery, so they are not connected: a lost action would be an unknown motion")
                .fix(format!("publish it reliable, or -p qos_overrides.{shown}.subscription.reliability:=best_effort on predictor, planner and evaluator")),
        );
    }
    if stream.timeline.is_empty() {
        findings.push(
            Finding::note(
                CHECK,
                format!("{shown} has a publisher, but no message arrived"),
            )
            .because("an arm at rest may publish nothing; the last action then stays in effect")
            .fix("move the arm and repeat the check"),
        );
        return findings;
    }
    let rate = match stream.timeline.period_s() {
        Some(period_s) => hertz(Duration::from_secs_f64(period_s)),
        None => format!("{} messages", stream.timeline.len()),
    };
    if actions.is_chunk {
        let what = format!("{shown} has action chunks, the plans of a policy");
        findings.push(
            Finding::error(CHECK, what)
                .because("single actions (wm_msgs/Action) show what the arm did")
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
    findings.extend(stamped_with(&shown, actions, survey, camera));
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

fn absent(survey: &Survey, wanted: Option<&str>) -> Finding {
    let what = match wanted {
        Some(name) => format!("nobody publishes actions on {}", of_others(name)),
        None => "no actions (wm_msgs/Action)".to_owned(),
    };
    let why = "predictions then assume an arm at rest, and its motion counts as error of the model";
    let fix = match survey.motions.first() {
        Some(motion) => format!(
            "wm init DIR --action {}, which starts the action adapter for it (docs/arm.md)",
            of_others(&motion.topic)
        ),
        None => "let the driver publish each action that it takes as wm_msgs/Action, or its velocities, poses or tf for wm action_adapter (docs/arm.md)".to_owned(),
    };
    Finding::warning(CHECK, what).because(why).fix(fix)
}

/// Whether the values match the model's action space.
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
            .fix("publish the actions that the model was trained on, in m and rad, or train one on these actions (wm bag import --action-space FILE, wm train model)")
    };
    wrong.map(finding).into_iter().collect()
}

/// Whether one clock stamps actions and frames.
fn stamped_with(
    name: &str,
    actions: &Actions,
    survey: &Survey,
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
            .fix("stamp each action with the time at which it is taken"),
        );
    }
    let camera = survey.camera(camera)?.1.best()?;
    let apart_s = actions.stream.timeline.delay_s()? - camera.timeline.delay_s()?;
    let finding = || {
        Finding::warning(CHECK, format!("{name}: stamps of actions and frames are {:.1} s apart", apart_s.abs()))
            .because("actions are matched with frames by stamp, here with frames of another time")
            .fix("stamp both by one clock: synchronise the machines, and stamp actions when they are taken")
    };
    (apart_s.abs() > APART_S).then(finding)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, Level, Motion, Stream, fit::facts, timeline::regular};
    use wm_ros::Qos;

    fn survey(qos: Qos, delay_ms: i64, values: Vec<f32>) -> Survey {
        let stream = |delay_ms| Stream {
            timeline: regular(9, 100, delay_ms),
            publishers: vec![qos],
            ..Stream::default()
        };
        let mut survey = Survey::default();
        let actions = Actions {
            stream: stream(delay_ms),
            values: vec![values],
            ..Actions::default()
        };
        survey.actions.insert(DEFAULT_ACTION.into(), actions);
        let camera = Camera {
            raw: Some(stream(10)),
            ..Camera::default()
        };
        survey.cameras.insert("/camera/image_raw".into(), camera);
        survey
    }

    fn levels(survey: &Survey) -> Vec<Level> {
        let found = check(survey, None, None, Some(&facts()));
        found.iter().map(|finding| finding.level).collect()
    }

    #[test]
    fn good_actions_are_one_line() {
        let survey = survey(Qos::reliable(10), 5, vec![0.0; 7]);
        let found = check(&survey, None, None, Some(&facts()));
        assert_eq!(found, [Finding::ok(CHECK, "/wm/action: 7 values, 10 Hz")]);
    }

    #[test]
    fn unusable_actions_are_an_error() {
        let best_effort = survey(Qos::best_effort(10), 5, vec![0.0; 7]);
        assert_eq!(levels(&best_effort), [Level::Error, Level::Ok]);
        let eight = survey(Qos::reliable(10), 5, vec![0.0; 8]);
        assert_eq!(levels(&eight), [Level::Ok, Level::Error]);
        // millimetres
        let large = survey(
            Qos::reliable(10),
            5,
            vec![50.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        );
        assert_eq!(levels(&large), [Level::Ok, Level::Error]);
    }

    #[test]
    fn two_clocks_are_reported() {
        let apart = survey(Qos::reliable(10), 3_000, vec![0.0; 7]);
        assert_eq!(levels(&apart), [Level::Ok, Level::Warning]);
    }

    #[test]
    fn arm_without_actions_gets_an_adapter() {
        let mut survey = Survey::default();
        let fix = |survey: &Survey| check(survey, None, None, None)[0].fix.clone().unwrap();
        assert!(fix(&survey).contains("docs/arm.md"));
        survey.motions.push(Motion {
            topic: "/arm/twist".into(),
            type_name: "geometry_msgs/msg/TwistStamped".into(),
            source: "twist",
        });
        assert!(fix(&survey).contains("wm init DIR --action /arm/twist"));
    }
}
