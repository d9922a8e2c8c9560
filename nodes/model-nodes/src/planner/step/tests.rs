#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

mod goals;

use std::sync::LazyLock;

use candle_core::{Device, Tensor};
use wm_model::{sampler::Given, transition::TransitionConfig};
use wm_msgs::{builtin_interfaces::Duration as Period, std_msgs::Header, wm_msgs::Plan};
use wm_planner::{Arrival, CemSettings, PlannerChoice, Target, Weights};
use wm_zoo::subgoals::{SubgoalConfig, TrainedSubgoals};

use super::*;
use crate::{
    planner::{MotionLimits, PlannerError, PlannerModel, PlannerParts, PlannerSetup, WorkspaceBox},
    test_world::{PERIOD, history, latent, stamp, values, world_model},
};
use wm_ros::PublisherId;

const MAX_AGE: Duration = Duration::from_secs(2);
/// When frame 0 was received.
static BEGIN: LazyLock<Instant> = LazyLock::new(Instant::now);

fn planner_that_begins(lead: Lead) -> PlannerStep {
    let settings = PlannerSettings {
        plan_period_ns: 2 * PERIOD,
        max_age: MAX_AGE,
        lead,
        seed: 5,
        needs_pose: false,
    };
    PlannerStep::new(settings, history())
}

fn planner() -> PlannerStep {
    planner_that_begins(Lead::Steps(0))
}

fn searching(setup: PlannerSetup, searched: &[&str]) -> Result<PlannerModel, PlannerError> {
    let searched: Vec<String> = searched.iter().map(|name| (*name).to_owned()).collect();
    let parts = PlannerParts {
        model: world_model(),
        idm: None,
        subgoals: None,
        distance: None,
        probe: None,
        decoder: None,
        workers: None,
    };
    let setup = PlannerSetup {
        search: searched,
        ..setup
    };
    PlannerModel::new(parts, setup)
}

fn model(setup: PlannerSetup) -> PlannerModel {
    searching(setup, &[]).unwrap()
}

fn settings() -> PlannerSetup {
    let cem = CemSettings {
        population: 32,
        iterations: 3,
        elites: 8,
        ..CemSettings::default()
    };
    PlannerSetup {
        choice: Some(PlannerChoice::Cem),
        settings: wm_planner::PlannerSettings {
            cem,
            ..Default::default()
        },
        horizon: 2,
        batch: 64,
        weights: Weights::default(),
        success: 0.0,
        steps_to_goal: 0.0,
        subgoal_steps: 1,
        spread_seeds: 0,
        arrival: Arrival::default(),
        integration_steps: Some(1),
        search: Vec::new(),
        limits: MotionLimits {
            translation: Some(0.02),
            ..MotionLimits::default()
        },
    }
}

/// When frame `index` is received.
fn at(index: u32) -> Instant {
    *BEGIN + Duration::from_nanos(PERIOD as u64) * index
}

/// Sends the frames of a span, before each the robot's action.
fn feed_moving(step: &mut PlannerStep, span: std::ops::RangeInclusive<u32>, moving: &[f32; 7]) {
    feed_of(step, span, moving, false);
}

/// The same, of a camera that has stopped or not.
fn feed_of(
    step: &mut PlannerStep,
    span: std::ops::RangeInclusive<u32>,
    moving: &[f32; 7],
    frozen: bool,
) {
    for index in span {
        let header = Header {
            stamp: stamp(i64::from(index)),
            frame_id: "base".into(),
        };
        let action = Action {
            header,
            values: moving.to_vec(),
        };
        step.action(&action, Time::default()).unwrap();
        let latent = Latent {
            frozen,
            ..latent(i64::from(index))
        };
        let reception = Reception {
            stamp: Time::default(),
            clock_step_ns: 0,
            at: at(index),
            publisher: PublisherId::default(),
        };
        step.latent(&latent, reception).unwrap();
    }
}

fn feed(step: &mut PlannerStep, span: std::ops::RangeInclusive<u32>) {
    feed_moving(step, span, &[0.0; 7]);
}

fn goal(index: i64) -> Goal {
    Goal::of_latent(stamp(index), values(index).into())
}

#[test]
fn it_waits_for_a_goal_and_for_frames_by_name() {
    let mut step = planner();
    assert_eq!(step.request(at(0)).unwrap_err(), PlanWait::NoGoal);
    step.set_goal(goal(40), Time::default());
    let wait = step.request(at(0)).unwrap_err();
    assert_eq!(wait, PlanWait::History(Wait::NoFrame));
    assert_eq!(wait.to_string(), "no frame has arrived yet");
    feed(&mut step, 0..=2);
    assert!(step.request(at(2)).is_ok());
}

#[test]
fn stopped_camera_is_not_planned_from_and_each_due_plan_counts() {
    let mut step = planner();
    step.set_goal(goal(40), Time::default());
    feed(&mut step, 0..=2);
    let request = step.request(at(2)).unwrap();
    let found = model(settings()).plan(&request, &mut |_, _| false).unwrap();
    let frozen = |step: &mut PlannerStep, index| feed_of(step, index..=index, &[0.0; 7], true);
    frozen(&mut step, 3);
    let unsent = step
        .planned(&request, &found, Duration::ZERO, at(3))
        .unwrap_err();
    assert_eq!(unsent.reason(), "frozen_camera");
    let mut due = 0;
    for index in 4..=14 {
        frozen(&mut step, index);
        let Err(PlanWait::Frozen { is_due }) = step.request(at(index)) else {
            panic!("a plan from a stopped camera")
        };
        due += u32::from(is_due);
        assert_eq!(
            step.request(at(index)).unwrap_err(),
            PlanWait::Frozen { is_due: false },
            "once a frame"
        );
    }
    assert!((2..=11).contains(&due), "{due}");
    feed(&mut step, 15..=24);
    assert!(step.request(at(24)).is_ok(), "the camera works again");
}

#[test]
fn a_plan_says_what_it_was_computed_from_and_keeps_the_bounds() {
    let mut step = planner();
    step.set_goal(goal(40), Time::default());
    feed(&mut step, 0..=2);
    let request = step.request(at(2)).unwrap();
    let found = model(settings()).plan(&request, &mut |_, _| false).unwrap();
    let plan = &found.message;
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
    assert_eq!((plan.epoch, plan.lead_steps), (request.moment.epoch, 0));
    assert_eq!(plan.period, Period::from_nanos(2 * PERIOD));
    assert_eq!(plan.iteration_costs.len(), 3);
    assert!(plan.cost <= plan.iteration_costs[0] && !plan.deadline_cut);
    let stamps: Vec<_> = plan
        .actions
        .iter()
        .map(|action| action.header.stamp)
        .collect();
    assert_eq!(stamps, [stamp(2), stamp(4)]);
    for (model, action) in found.actions.actions.iter().zip(&plan.actions) {
        assert_eq!(action.header.frame_id, "base");
        // Each of the two intervals of a step makes one half.
        let (translations, rotations) = (&model[..3], &model[3..]);
        assert!(
            translations
                .iter()
                .all(|value| value.abs() <= 0.02 / 2.0 * 35.0 + 1e-6)
        );
        assert!(rotations.iter().all(|value| value.abs() <= 1.39 + 1e-6));
        assert!(
            action.values[..3]
                .iter()
                .all(|delta| delta.abs() <= 0.02 + 1e-6),
            "{action:?}"
        );
        let same = world_model().encoding.decode_step(&whole(model)).unwrap();
        assert_eq!(action.values, same);
    }
    let told: serde_json::Value = serde_json::from_str(&plan.settings).unwrap();
    assert_eq!(
        (told["cem"]["population"].as_u64(), told["horizon"].as_u64()),
        (Some(32), Some(2))
    );
    assert_eq!(
        (
            told["integration_steps"].as_u64(),
            told["model_hash"].as_str()
        ),
        (Some(1), Some("beef"))
    );

    let again = model(settings()).plan(&request, &mut |_, _| false).unwrap();
    assert_eq!(found.actions, again.actions);
    let cut = model(settings()).plan(&request, &mut |_, _| true).unwrap();
    let cut = cut.message;
    assert!(cut.deadline_cut && cut.iteration_costs.len() == 1);
}

/// The model action of a searched one: the gripper of a robot that says 0 is closed.
fn whole(searched: &[f32]) -> Vec<f32> {
    [searched, &[1.0]].concat()
}

#[test]
fn plans_are_a_period_apart_and_start_from_the_last_one() {
    let mut step = planner();
    step.set_goal(goal(40), Time::default());
    feed(&mut step, 0..=2);
    let request = step.request(at(2)).unwrap();
    assert_eq!((request.seed, &request.start), (5, &None));
    let found = model(settings()).plan(&request, &mut |_, _| false).unwrap();
    let taken = Duration::from_millis(100);
    assert_eq!(step.planned(&request, &found, taken, at(2) + taken), Ok(()));
    feed(&mut step, 3..=3);
    assert_eq!(step.request(at(3)).unwrap_err(), PlanWait::Recent);
    feed(&mut step, 4..=4);
    let next = step.request(at(4)).unwrap();
    assert_eq!((next.seed, next.start), (6, found.actions.without(1)));

    step.set_goal(goal(41), Time::default());
    assert_eq!(
        step.request(at(4)).unwrap().start,
        None,
        "another goal is planned for at once and anew"
    );
}

/// A search that takes longer than the plan period is behind the next request when it ends, and still a start.
#[test]
fn a_search_slower_than_the_period_still_starts_the_next_one() {
    let mut step = planner_that_begins(Lead::Measured {
        first: Duration::from_secs(1),
    });
    let model = model(PlannerSetup {
        horizon: 6,
        ..settings()
    });
    step.set_goal(goal(40), Time::default());
    feed(&mut step, 0..=2);
    let first = step.request(at(2)).unwrap();
    // The period has passed while the first search goes on: the second one waits for it.
    feed(&mut step, 3..=4);
    let second = step.request(at(4)).unwrap();
    assert_eq!(second.start, None);
    feed(&mut step, 5..=7);
    let found = model.plan(&first, &mut |_, _| false).unwrap();
    let taken = Duration::from_secs(1);
    assert_eq!(step.planned(&first, &found, taken, at(7)), Ok(()));
    feed(&mut step, 8..=8);
    let third = step.request(at(8)).unwrap();
    // It begins three model steps later than the first.
    assert_eq!(third.begin_ns() - first.begin_ns(), 6 * PERIOD);
    assert!(third.start.is_some());
    assert_eq!(third.start, found.actions.without(3));
}

/// The robot goes on while a plan is searched for.
#[test]
fn a_plan_begins_where_the_robot_will_be_when_it_is_ready() {
    let mut step = planner_that_begins(Lead::Measured {
        first: Duration::from_millis(1100),
    });
    step.set_goal(goal(40), Time::default());
    let moving = [0.01, 0.0, -0.01, 0.0, 0.05, 0.0, 1.0];
    feed_moving(&mut step, 0..=2, &moving);
    // 0.1 s and 1.1 s: three steps of 0.4 s.
    let request = step.request(at(2) + Duration::from_millis(100)).unwrap();
    assert_eq!((request.lead_steps(), request.until.len()), (3, 4));
    assert_eq!(request.begin_ns(), stamp(8).to_nanos());
    let found = model(settings()).plan(&request, &mut |_, _| false).unwrap();
    let plan = &found.message;
    assert_eq!((plan.lead_steps, plan.header.stamp), (3, stamp(2)));
    let stamps = plan.actions.iter().map(|action| action.header.stamp);
    assert_eq!(stamps.collect::<Vec<_>>(), [stamp(8), stamp(10)]);

    // Its cost is that of the whole way: what the robot does until then, and the plan.
    let model = world_model();
    let mut sampler = model.transition.config().sampler.clone();
    sampler.steps = 1;
    let rollout = request
        .moment
        .rollout(&model.transition, &sampler, request.seed);
    let mut rollout = rollout.unwrap();
    let open = |action: &Vec<f32>| [action.as_slice(), &[-1.0]].concat();
    let until = request.until[..3]
        .iter()
        .map(|step| step.model.values.clone());
    let way: Vec<Vec<f32>> = until
        .chain(found.actions.actions.iter().map(open))
        .collect();
    let mut reached = None;
    for action in &way {
        let action = Tensor::from_slice(action, (1, 7), &Device::Cpu).unwrap();
        reached = Some(rollout.next_given(&action, Given::default()).unwrap());
    }
    let target = Tensor::from_vec(values(40), (4, 4, 4), &Device::Cpu).unwrap();
    let costs = Target::LastStep(target).costs(&reached.unwrap().unsqueeze(1).unwrap());
    assert!((costs.unwrap()[0] - plan.cost).abs() < 1e-5);

    // The next one begins by how long this one took.
    let taken = Duration::from_millis(300);
    assert_eq!(step.planned(&request, &found, taken, at(2) + taken), Ok(()));
    feed_moving(&mut step, 3..=4, &moving);
    assert_eq!(step.request(at(4)).unwrap().lead_steps(), 1);

    // A search of a moment is over long before the next model step: the plan begins with its frame.
    let mut step = planner_that_begins(Lead::Measured {
        first: Duration::from_millis(60),
    });
    step.set_goal(goal(40), Time::default());
    feed(&mut step, 0..=2);
    assert_eq!(step.request(at(2)).unwrap().lead_steps(), 0);

    let mut step = planner_that_begins(Lead::Steps(2));
    step.set_goal(goal(40), Time::default());
    feed(&mut step, 0..=2);
    assert_eq!(step.request(at(2)).unwrap().begin_ns(), stamp(6).to_nanos());
}

fn plan_of(moving: &[f32; 7], searched: &[&str]) -> Plan {
    let mut step = planner();
    step.set_goal(goal(40), Time::default());
    feed_moving(&mut step, 0..=2, moving);
    let request = step.request(at(2)).unwrap();
    let model = searching(settings(), searched).unwrap();
    model.plan(&request, &mut |_, _| false).unwrap().message
}

#[test]
fn what_is_not_searched_stays_and_what_was_is_named() {
    let moving = |gripper| [0.02, 0.0, 0.0, 0.0, 0.1, 0.0, gripper];
    let poses = ["dx", "dy", "dz", "droll", "dpitch", "dyaw"];
    for gripper in [0.0, 1.0] {
        let plan = plan_of(&moving(gripper), &[]);
        assert_eq!(plan.searched, poses);
        assert!(
            plan.actions
                .iter()
                .all(|action| action.values[6] == gripper)
        );
        assert!(plan.actions.iter().any(|action| action.values[0] != 0.0));
    }
    let plan = plan_of(&moving(1.0), &["dz", "dx"]);
    assert_eq!(plan.searched, ["dx", "dz"]);
    for action in &plan.actions {
        let values = &action.values;
        assert_eq!(
            [values[1], values[3], values[4], values[5]],
            [0.0; 4],
            "no motion"
        );
        assert_eq!(values[6], 1.0, "a state holds");
    }
    let told: serde_json::Value = serde_json::from_str(&plan.settings).unwrap();
    assert_eq!(told["searched"], serde_json::json!(["dx", "dz"]));
    assert_eq!(told["bounds"].as_array().unwrap().len(), 2);

    let plan = plan_of(&moving(1.0), &["gripper"]);
    assert_eq!(plan.searched, ["gripper"]);
    assert!(
        plan.actions
            .iter()
            .all(|action| [0.0, 1.0].contains(&action.values[6]))
    );

    let error = searching(settings(), &["dx", "grip"])
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("\"grip\"") && error.contains("dx dy dz"),
        "{error}"
    );
}

/// A camera that has stopped says nothing of where the robot is.
#[test]
fn nothing_is_planned_or_sent_from_a_frame_that_is_too_old() {
    let mut step = planner();
    step.set_goal(goal(40), Time::default());
    feed(&mut step, 0..=2);
    let late = at(2) + MAX_AGE + Duration::from_millis(1);
    let wait = step.request(late).unwrap_err();
    assert!(
        matches!(wait, PlanWait::History(Wait::Stale { .. })),
        "{wait}"
    );

    let request = step.request(at(2) + MAX_AGE).unwrap();
    let found = model(settings()).plan(&request, &mut |_, _| false).unwrap();
    let taken = Duration::from_millis(1);
    let unsent = step.planned(&request, &found, taken, late).unwrap_err();
    assert_eq!(unsent.reason(), "stale_frame");
    assert!(unsent.to_string().contains("at most 2.0 s"), "{unsent}");
    // It was a search all the same: the next one starts there.
    feed(&mut step, 3..=4);
    assert_eq!(step.request(at(4)).unwrap().start, found.actions.without(1));
}

#[test]
fn a_plan_whose_actions_are_over_is_not_sent() {
    let mut step = planner();
    step.set_goal(goal(40), Time::default());
    feed(&mut step, 0..=2);
    let request = step.request(at(2)).unwrap();
    let found = model(settings()).plan(&request, &mut |_, _| false).unwrap();
    feed(&mut step, 3..=7);
    // Two steps of 0.4 s from frame 2 on end with frame 6.
    let taken = Duration::from_secs(1);
    let unsent = step.planned(&request, &found, taken, at(7)).unwrap_err();
    assert_eq!(unsent, Unsent::Late { taken_s: 1.0 });
    assert_eq!(step.planned(&request, &found, taken, at(6)), Ok(()));
}

#[test]
fn a_jump_and_a_reset_forget_the_history_but_not_the_goal() {
    let mut step = planner();
    step.set_goal(goal(40), Time::default());
    feed(&mut step, 0..=20);
    let request = step.request(at(20)).unwrap();
    let found = model(settings()).plan(&request, &mut |_, _| false).unwrap();
    feed(&mut step, 0..=2);
    let unsent = step.planned(&request, &found, Duration::ZERO, at(20));
    assert_eq!(unsent, Err(Unsent::Superseded));
    assert_eq!(
        step.request(at(2)).unwrap().start,
        None,
        "a plan of the time before is no start"
    );

    let said = step.reset(Some(70), Time::default());
    assert!(said.contains("kept the goal; seed 70"), "{said}");
    assert_eq!(
        step.request(at(2)).unwrap_err(),
        PlanWait::History(Wait::NoFrame)
    );
    feed(&mut step, 3..=5);
    assert_eq!(step.request(at(5)).unwrap().seed, 70);
    let said = step.reset(None, Time::default());
    assert!(said.contains("seed 71"), "the present one goes on: {said}");
}

#[test]
fn missing_networks_are_named_with_what_trains_them() {
    let refused = |setup: PlannerSetup| searching(setup, &[]).unwrap_err().to_string();
    let error = refused(PlannerSetup {
        choice: Some(PlannerChoice::SubgoalsIdm),
        ..settings()
    });
    assert!(
        error.contains("subgoals+idm") && error.contains("wm train subgoals"),
        "{error}"
    );
    let error = refused(PlannerSetup {
        steps_to_goal: 1.0,
        ..settings()
    });
    assert!(error.contains("wm train distance"), "{error}");
}

#[test]
fn subgoals_of_another_model_step_are_refused() {
    let network = TransitionConfig {
        frame_skip: 3,
        max_frames: 3,
        ..TransitionConfig::preset("tiny", (4, 4, 4), 2, 1).unwrap()
    };
    let distances = SubgoalConfig { distances: vec![1] };
    let subgoals = TrainedSubgoals::random(network, distances, world_model().space, 1).unwrap();
    let parts = PlannerParts {
        model: world_model(),
        idm: None,
        subgoals: Some(Arc::new(subgoals)),
        distance: None,
        probe: None,
        decoder: None,
        workers: None,
    };
    let setup = PlannerSetup {
        choice: Some(PlannerChoice::SubgoalsIdm),
        ..settings()
    };
    let error = PlannerModel::new(parts, setup).unwrap_err().to_string();
    assert!(
        error.contains("3 camera frames") && error.contains("have 2"),
        "{error}"
    );
}
