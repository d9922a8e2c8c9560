#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use wm_msgs::{builtin_interfaces::Duration as Period, std_msgs::Header, wm_msgs::ActionChunk};

use super::*;
use crate::{
    evaluator::EvaluatorModel,
    test_world::{PERIOD, history, latent, stamp, world_model},
};
use wm_ros::PublisherId;

fn header(index: i64) -> Header {
    Header {
        stamp: stamp(index),
        frame_id: "camera".into(),
    }
}

fn action(index: i64, value: f32) -> Action {
    Action {
        header: header(index),
        values: vec![value, 0.0, -value, 0.0, 0.0, 0.0, 1.0],
    }
}

fn chunk(index: i64, count: i64, value: f32) -> ActionChunk {
    ActionChunk {
        header: header(index),
        period: Period::from_nanos(PERIOD),
        actions: (0..count).map(|i| action(index + i, value)).collect(),
        ..ActionChunk::default()
    }
}

fn candidates(chunks: Vec<ActionChunk>) -> ActionCandidates {
    ActionCandidates {
        header: header(2),
        policy: "test".into(),
        chunks,
    }
}

/// Sends frame `index`.
fn see(step: &mut EvaluatorStep, index: i64) {
    see_of(step, index, false);
}

/// The same, of a camera that has stopped or not.
fn see_of(step: &mut EvaluatorStep, index: i64, frozen: bool) {
    let latent = Latent {
        frozen,
        ..latent(index)
    };
    let reception = Reception {
        stamp: Time::default(),
        clock_step_ns: 0,
        at: Instant::now(),
        publisher: PublisherId::default(),
    };
    step.latent(&latent, reception).unwrap();
}

/// An evaluator that has seen frames 0 to 2 and the actions between.
fn evaluator() -> EvaluatorStep {
    let settings = EvaluatorSettings {
        max_age: Duration::from_secs(60),
        horizon: 5,
        max_candidates: 3,
        seed: 9,
    };
    let mut step = EvaluatorStep::new(settings, history());
    for index in 0..3 {
        step.action(&action(index, 0.01), Time::default()).unwrap();
        see(&mut step, index);
    }
    step
}

/// Sends candidates, as the node does.
fn ask(
    step: &EvaluatorStep,
    asked: &ActionCandidates,
) -> Result<EvaluationRequest, EvaluatorError> {
    step.candidates(asked, Instant::now(), Time::default())
}

#[test]
fn candidates_are_not_evaluated_from_a_stopped_camera() {
    let mut step = evaluator();
    let asked = candidates(vec![chunk(2, 8, 0.02)]);
    see_of(&mut step, 3, true);
    let error = ask(&step, &asked).unwrap_err();
    assert_eq!(error.reason(), "frozen_camera");
    assert!(
        error.to_string().contains("the camera has stopped"),
        "{error}"
    );
    see(&mut step, 4);
    assert!(ask(&step, &asked).is_ok());
}

#[test]
fn candidates_are_compared_at_one_moment() {
    let step = evaluator();
    // Four model steps, and two and a half: whole ones are compared.
    let asked = candidates(vec![chunk(2, 8, 0.02), chunk(2, 5, -0.02)]);
    let request = ask(&step, &asked).unwrap();
    assert_eq!(request.horizon, 2);
    // And what each does after them.
    let steps: Vec<usize> = request.candidates.iter().map(Vec::len).collect();
    assert_eq!(steps, [3, 3]);
    let short = candidates(vec![chunk(2, 1, 0.02)]);
    let short = ask(&step, &short).unwrap();
    assert_eq!(short.horizon, 1, "one at least");
    // The action that was really taken at the observed moment is the first of both.
    assert_eq!(request.candidates[0][0].intervals[0].values[0], 0.01);
    assert_eq!(request.candidates[0][0].intervals[1].values[0], 0.02);
    let long = candidates(vec![chunk(2, 40, 0.02)]);
    assert_eq!(ask(&step, &long).unwrap().horizon, 5, "the horizon");
}

#[test]
fn candidates_wait_for_the_frame_that_they_answer() {
    let mut step = evaluator();
    // The newest frame is 2; a model step is two frames.
    for (begin, awaits) in [(1, false), (2, false), (3, true), (4, true), (5, false)] {
        let asked = candidates(vec![chunk(2, 8, 0.02), chunk(begin, 8, 0.02)]);
        assert_eq!(step.awaits_frame(&asked), awaits, "{begin}");
    }
    let asked = candidates(vec![chunk(3, 8, 0.02)]);
    see(&mut step, 3);
    assert!(!step.awaits_frame(&asked), "it has come");
    assert_eq!(ask(&step, &asked).unwrap().horizon, 4);
    assert!(!step.awaits_frame(&candidates(Vec::new())));
}

#[test]
fn a_candidate_beyond_the_horizon_is_named_with_what_to_do() {
    let step = evaluator();
    // Five model steps of two actions after frame 2.
    let last = candidates(vec![chunk(2, 4, 0.02), chunk(11, 4, 0.02)]);
    assert!(ask(&step, &last).is_ok());
    for beyond in [12, 1_000_000] {
        let asked = candidates(vec![chunk(2, 4, 0.02), chunk(beyond, 4, 0.02)]);
        let error = ask(&step, &asked).unwrap_err();
        assert_eq!(error.reason(), "late_candidates");
        let text = error.to_string();
        assert!(
            text.starts_with("candidate 1: ") && text.contains("stamp it with"),
            "{text}"
        );
    }
}

#[test]
fn batched_candidates_equal_rollouts_and_the_nearest_is_best() {
    let mut step = evaluator();
    let model = world_model();
    let asked = candidates(vec![
        chunk(2, 4, 0.03),
        chunk(2, 4, -0.03),
        chunk(2, 4, 0.0),
    ]);
    let request = ask(&step, &asked).unwrap();
    let without = EvaluatorModel::new(model.clone(), 1)
        .evaluate(&request)
        .unwrap()
        .assessment;
    assert_eq!(
        (without.best, without.horizon, without.candidates.len()),
        (-1, 2, 3)
    );
    assert!(
        without
            .candidates
            .iter()
            .all(|c| c.cost.is_nan() && c.step_costs.is_empty())
    );
    assert_eq!(without.candidates[0].latent.header, header(6));

    // The goal is where the second candidate leads, by a rollout of its own.
    let mut sampler = model.transition.config().sampler.clone();
    sampler.steps = 1;
    let moment = &request.moment;
    let mut rollout = moment.rollout(&model.transition, &sampler, 9).unwrap();
    let actions = &request.candidates[1];
    let mut reached = Vec::new();
    for (action, next) in actions.iter().zip(&actions[1..]) {
        let (fed, own) = (
            [action.model.values.as_slice()],
            [next.model.values.as_slice()],
        );
        reached = rollout.predict(&fed, Some(&own)).unwrap().concat();
    }
    step.set_goal(Goal::of_latent(Time::default(), reached.into()));
    let request = ask(&step, &asked).unwrap();
    let found = EvaluatorModel::new(model, 1)
        .evaluate(&request)
        .unwrap()
        .assessment;
    assert_eq!((found.best, found.candidates[1].cost), (1, 0.0));
    assert!(found.candidates[0].cost > 0.0 && found.candidates[2].cost > 0.0);
    assert_eq!(found.candidates[0].step_costs.len(), 2);
    assert_eq!(found.candidates[0].step_costs[1], found.candidates[0].cost);
    assert_eq!(
        (found.policy.as_str(), found.model_hash.as_str(), found.seed),
        ("test", "beef", 9)
    );
    assert_eq!(found.header.stamp, header(2).stamp);
}

#[test]
fn candidates_that_cannot_be_used_are_named() {
    let step = evaluator();
    let refused = |chunks| ask(&step, &candidates(chunks)).unwrap_err().to_string();
    assert_eq!(refused(Vec::new()), "0 candidates; expected 1 to 3");
    assert!(refused(vec![chunk(2, 4, 0.0); 4]).starts_with("4 candidates"));
    let error = refused(vec![chunk(2, 4, 0.0), chunk(2, 4, f32::NAN)]);
    assert!(
        error.starts_with("candidate 1: action 0 of a chunk"),
        "{error}"
    );
    assert!(
        refused(vec![chunk(0, 2, 0.0)]).starts_with("candidate 0 ends before the observed frame")
    );
    let nothing = EvaluatorStep::new(step.settings, history());
    let error = ask(&nothing, &candidates(vec![chunk(2, 4, 0.0)])).unwrap_err();
    assert!(matches!(error, EvaluatorError::Waiting(Wait::NoFrame)));
}

#[test]
fn candidates_are_not_assessed_from_a_frame_that_is_too_old() {
    let step = evaluator();
    let asked = candidates(vec![chunk(2, 4, 0.0)]);
    let later = Instant::now() + Duration::from_secs(61);
    let error = step.candidates(&asked, later, Time::default()).unwrap_err();
    assert!(
        matches!(error, EvaluatorError::Waiting(Wait::Stale { .. })),
        "{error}"
    );
    assert_eq!(error.reason(), "no_history");
    assert!(error.to_string().contains("max_age"), "{error}");
}

/// Until a candidate begins, the robot executes the current chunk.
#[test]
fn the_chunk_under_way_is_done_until_a_candidate_begins() {
    let mut step = evaluator();
    step.chunk(&chunk(2, 8, 0.05), Time::default()).unwrap();
    let request = ask(&step, &candidates(vec![chunk(5, 8, 0.02)])).unwrap();
    let steps = request.candidates[0]
        .iter()
        .flat_map(|step| &step.intervals);
    let metres: Vec<f32> = steps.map(|interval| interval.values[0]).take(5).collect();
    assert_eq!(metres, [0.01, 0.05, 0.05, 0.02, 0.02]);
}
