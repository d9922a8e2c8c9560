#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use wm_model::{
    actions::ActionEncoding,
    planner::CemSettings,
    transition::{Transition, TransitionConfig},
};
use wm_msgs::{builtin_interfaces::Duration, std_msgs::Header};

use super::*;
use crate::{planner::PlannerModel, predictor::PredictorModel};
use wm_wire::latent_message::{LatentDtype, encode_latent};

const PERIOD: i64 = 200_000_000;
const START: i64 = 1_700_000_000_000_000_000;

fn space() -> LatentSpace {
    LatentSpace {
        name: "test".into(),
        hash: "00ff".into(),
        height: 4,
        width: 4,
        channels: 4,
    }
}

fn planner() -> PlannerStep {
    let settings = PlannerSettings {
        context_frames: 2,
        plan_period_ns: 2 * PERIOD,
        seed: 5,
    };
    PlannerStep::new(settings, Timing::new(PERIOD, 2), space())
}

fn model(settings: CemSettings) -> PlannerModel {
    let config = TransitionConfig {
        hidden: 64,
        depth: 1,
        heads: 2,
        ..TransitionConfig::preset("tiny", (4, 4, 4), 2, 7).unwrap()
    };
    let model = PredictorModel {
        transition: Transition::random(config, 3).unwrap().pack().unwrap(),
        name: "test".into(),
        hash: "beef".into(),
        space: space(),
        encoding: ActionEncoding::default(),
    };
    PlannerModel::new(model, settings, 1, 0.02, f64::INFINITY).unwrap()
}

fn settings() -> CemSettings {
    CemSettings {
        population: 32,
        iterations: 3,
        elites: 8,
        horizon: 2,
        ..CemSettings::default()
    }
}

fn stamp(index: i64) -> Time {
    Time::from_nanos(START + index * PERIOD)
}

fn values(index: i64) -> Vec<f32> {
    (0..64)
        .map(|i| ((i + 7 * index) as f32 * 0.3).sin())
        .collect()
}

fn feed(step: &mut PlannerStep, span: std::ops::RangeInclusive<i64>) {
    for index in span {
        let header = Header {
            stamp: stamp(index),
            frame_id: "base".into(),
        };
        step.action(&Action {
            header,
            values: vec![0.0; 7],
        })
        .unwrap();
        let header = Header {
            stamp: stamp(index),
            frame_id: "camera".into(),
        };
        step.latent(&encode_latent(&values(index), &space(), LatentDtype::F16, header).unwrap())
            .unwrap();
    }
}

fn goal(index: i64) -> Goal {
    Goal {
        stamp: stamp(index),
        values: values(index).into(),
    }
}

#[test]
fn it_waits_for_a_goal_and_for_frames_by_name() {
    let mut step = planner();
    assert_eq!(step.request().unwrap_err(), PlanWait::NoGoal);
    step.set_goal(goal(40));
    let wait = step.request().unwrap_err();
    assert_eq!(wait, PlanWait::History(Wait::NoFrame));
    assert_eq!(wait.to_string(), "no frame has come yet");
    feed(&mut step, 0..=2);
    assert!(step.request().is_ok());
}

#[test]
fn a_plan_says_what_it_was_computed_from_and_keeps_the_bounds() {
    let mut step = planner();
    step.set_goal(goal(40));
    feed(&mut step, 0..=2);
    let request = step.request().unwrap();
    let (found, plan) = model(settings()).plan(&request, &mut || false).unwrap();
    assert_eq!(
        plan.header,
        Header {
            stamp: stamp(2),
            frame_id: "camera".into()
        }
    );
    assert_eq!(
        (plan.goal_stamp, plan.seed, plan.planner.as_str()),
        (stamp(40), 5, "cem")
    );
    assert_eq!(plan.period, Duration::from_nanos(2 * PERIOD));
    assert_eq!(plan.iteration_costs.len(), 3);
    assert!(plan.cost <= plan.iteration_costs[0] && !plan.deadline_cut);
    let stamps: Vec<_> = plan
        .actions
        .iter()
        .map(|action| action.header.stamp)
        .collect();
    assert_eq!(stamps, [stamp(2), stamp(4)]);
    for action in &plan.actions {
        assert_eq!(action.header.frame_id, "base");
        assert!(
            action.values[..3]
                .iter()
                .all(|delta| delta.abs() <= 0.02 + 1e-6),
            "{action:?}"
        );
        assert!(
            action.values[3..6]
                .iter()
                .all(|delta| delta.abs() <= 2.0 * 1.39 / 5.6 + 1e-6),
            "{action:?}"
        );
        assert!([0.0, 1.0].contains(&action.values[6]));
    }
    let told: serde_json::Value = serde_json::from_str(&plan.settings).unwrap();
    assert_eq!(
        (told["population"].as_u64(), told["horizon"].as_u64()),
        (Some(32), Some(2))
    );
    assert_eq!(
        (
            told["integration_steps"].as_u64(),
            told["model_hash"].as_str()
        ),
        (Some(1), Some("beef"))
    );

    let (again, _) = model(settings()).plan(&request, &mut || false).unwrap();
    assert_eq!(found, again);
    let (_, cut) = model(settings()).plan(&request, &mut || true).unwrap();
    assert!(cut.deadline_cut && cut.iteration_costs.len() == 1);
}

#[test]
fn plans_are_a_period_apart_and_start_from_the_last_one_shifted() {
    let mut step = planner();
    step.set_goal(goal(40));
    feed(&mut step, 0..=2);
    let request = step.request().unwrap();
    assert_eq!((request.seed, &request.start), (5, &None));
    let (found, _) = model(settings()).plan(&request, &mut || false).unwrap();
    assert!(step.planned(&request, &found));
    feed(&mut step, 3..=3);
    assert_eq!(step.request().unwrap_err(), PlanWait::Recent);
    feed(&mut step, 4..=4);
    let next = step.request().unwrap();
    assert_eq!((next.seed, next.start), (6, Some(found.shifted())));

    step.set_goal(goal(41));
    assert_eq!(
        step.request().unwrap().start,
        None,
        "another goal is planned for at once and anew"
    );
}

#[test]
fn a_jump_and_a_reset_forget_the_history_but_not_the_goal() {
    let mut step = planner();
    step.set_goal(goal(40));
    feed(&mut step, 0..=20);
    let request = step.request().unwrap();
    let (found, _) = model(settings()).plan(&request, &mut || false).unwrap();
    feed(&mut step, 0..=2);
    assert!(!step.planned(&request, &found), "it is stale");
    assert_eq!(
        step.request().unwrap().start,
        None,
        "a plan of the time before is no start"
    );

    let said = step.reset(Some(70));
    assert!(said.contains("kept the goal; seed 70"), "{said}");
    assert_eq!(
        step.request().unwrap_err(),
        PlanWait::History(Wait::NoFrame)
    );
    feed(&mut step, 3..=5);
    assert_eq!(step.request().unwrap().seed, 70);
    let said = step.reset(None);
    assert!(said.contains("seed 71"), "the present one goes on: {said}");
}
