#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use wm_planner::PlannerChoice;
use wm_sim::GoalKind;
use wm_zoo::ModelFolder;

use super::{
    controller::Controller,
    findings::{self, RunInfo},
    model::Model,
    settings::{ClosedLoopSettings, Goals},
    trial::{Setup, Trial, run},
};

/// tiny was not trained on it.
const SEED: u64 = 5_000_000;

fn setup<'a>(
    controller: Controller,
    model: Option<&'a Model>,
    settings: &'a ClosedLoopSettings,
) -> Setup<'a> {
    Setup {
        task: GoalKind::Reach,
        controller,
        is_perfect: false,
        model,
        frames_per_step: 2,
        settings,
    }
}

#[test]
fn oracle_succeeds_and_hold_fails() {
    let settings = ClosedLoopSettings::default();
    for seed in SEED..SEED + 3 {
        let trial = |controller| run(&setup(controller, None, &settings), seed).unwrap();
        let oracle = trial(Controller::Oracle);
        assert!(oracle.success && oracle.distance_m < 0.025, "{oracle:?}");
        let hold = trial(Controller::Hold);
        assert!(!hold.success && hold.steps >= 10, "{hold:?}");
    }
    let refused = run(&setup(Controller::Random, None, &settings), SEED);
    assert!(refused.unwrap_err().to_string().contains("model"));
}

#[test]
fn planner_reaches_the_pictured_goal_deterministically() {
    let model = Model::load(&ModelFolder::open("tiny").unwrap()).unwrap();
    let settings = ClosedLoopSettings {
        horizon: 2,
        ..ClosedLoopSettings::default()
    };
    let planner = Controller::Planner(PlannerChoice::Idm);
    let trial = || run(&setup(planner, Some(&model), &settings), SEED).unwrap();
    let (first, again) = (trial(), trial());
    assert!(first.success, "{first:?}");
    assert_eq!(
        first.plans.len(),
        first.steps - 1,
        "the first step is a rest"
    );
    assert_eq!(
        (first.steps, first.distance_m),
        (again.steps, again.distance_m)
    );
}

#[test]
fn perfect_model_brings_a_search_nearer() {
    let model = Model::load(&ModelFolder::open("tiny").unwrap()).unwrap();
    let settings = ClosedLoopSettings {
        horizon: 1,
        patience: 1.0,
        ..ClosedLoopSettings::default()
    };
    let planner = Controller::Planner(PlannerChoice::Icem);
    let trial = |is_perfect| {
        let setup = Setup {
            is_perfect,
            ..setup(planner, Some(&model), &settings)
        };
        run(&setup, SEED).unwrap()
    };
    let held = run(&setup(Controller::Hold, None, &settings), SEED).unwrap();
    assert!(trial(true).distance_m < held.distance_m);
}

#[test]
fn findings_count_successes_and_slow_plans() {
    let trial = |success, ms| Trial {
        seed: 1,
        success,
        steps: 4,
        distance_m: 0.01,
        plans: vec![wm_metrics::findings::PlanTime { ms, candidates: 10 }],
    };
    let about = RunInfo {
        task: "reach".into(),
        planner: "idm".into(),
        perfect_model: false,
        model: "tiny".into(),
        model_hash: "00".into(),
        seed: 1,
        settings: ClosedLoopSettings::default(),
        step_ms: 400.0,
    };
    let trials = [trial(true, 5.0), trial(true, 500.0), trial(false, 10.0)];
    let findings = findings::of(about, &trials).unwrap();
    let json: serde_json::Value = serde_json::from_str(&findings.to_json().unwrap()).unwrap();
    assert!((json["success_rate"].as_f64().unwrap() - 2.0 / 3.0).abs() < 1e-12);
    assert_eq!(json["deadline_misses"], 1);
    assert_eq!(json["plan_ms"]["p50"], 10.0);
    assert_eq!(json["episodes"][0]["distance_m"], 0.01);
    let interval = json["interval"].as_array().unwrap();
    assert!(interval[0].as_f64().unwrap() < 0.5 && interval[1].as_f64().unwrap() > 0.8);
}

fn of_planner(name: &str) -> ClosedLoopSettings {
    ClosedLoopSettings::of(GoalKind::Push, name.parse().unwrap())
}

/// Otherwise an episode takes minutes.
#[test]
fn every_search_costs_few_candidates_by_default() {
    for choice in PlannerChoice::ALL {
        let settings = of_planner(choice.name());
        settings.validate().unwrap();
        let planner = &settings.planner;
        let candidates = match choice {
            PlannerChoice::Idm | PlannerChoice::SubgoalsIdm => continue,
            PlannerChoice::Cem | PlannerChoice::IdmCem => {
                planner.cem.population * planner.cem.iterations
            }
            PlannerChoice::Icem | PlannerChoice::IdmIcem | PlannerChoice::SubgoalsIcem => {
                planner.icem.population * planner.icem.iterations
            }
            PlannerChoice::Mppi | PlannerChoice::IdmMppi => {
                planner.mppi.population * planner.mppi.iterations
            }
        };
        let most = if choice.needs_idm() { 12 } else { 120 };
        assert!(
            settings.horizon == 1 && candidates <= most,
            "{choice}: {candidates}"
        );
    }
    assert_eq!(of_planner("idm").horizon, 4);
}

#[test]
fn settings_are_changed_and_rejected_by_name() {
    let settings = of_planner("idm+icem");
    assert_eq!((settings.goals, settings.gripper), (Goals::Subgoals, true));
    let changed = settings.with("planner: {icem: {population: 7}}").unwrap();
    assert_eq!(changed.planner.icem.population, 7);
    assert_eq!(changed.goals, Goals::Subgoals);
    assert!(settings.with("populaton: 7").is_err());
    let refused = settings.with("horizon: 17").unwrap().validate();
    assert!(refused.unwrap_err().to_string().contains("17"));
    let unknown = "cme".parse::<Controller>().unwrap_err().to_string();
    assert!(
        unknown.contains("cme") && unknown.contains("idm+icem"),
        "{unknown}"
    );
}
