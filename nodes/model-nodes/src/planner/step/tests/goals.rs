//! Goals of several latents, regions, words, and the box that motion is kept within.

use super::*;
use crate::test_world::{history_of, other_space};

/// Values of several goals: near the observed ones, far from them, and farther.
fn several(times: &[i64]) -> Goal {
    let shifted = |by: f32| values(2).iter().map(|value| value + by).collect();
    Goal {
        latents: vec![shifted(0.1), shifted(1.0), shifted(2.0)],
        times_ns: times.iter().map(|steps| steps * 2 * PERIOD).collect(),
        ..goal(40)
    }
}

#[test]
fn goals_are_reached_one_after_the_other() {
    let mut step = planner();
    step.set_goal(several(&[]), Time::default());
    feed(&mut step, 0..=2);
    let model = model(settings());
    let request = step.request(at(2)).unwrap();
    let found = model.plan(&request, &mut |_, _| false).unwrap();
    assert_eq!(found.message.goal_index, 1, "the first one is reached");
    assert!(
        (found.message.distance - 4.0).abs() < 1e-3,
        "to the last one"
    );
    let taken = Duration::from_millis(1);
    step.planned(&request, &found, taken, at(2)).unwrap();
    // It stays far from the second one, which is given up after as many plans as it may take.
    let mut indices = Vec::new();
    for index in 0..5 {
        feed(&mut step, 3 + 2 * index..=4 + 2 * index);
        let now = at(4 + 2 * index);
        let request = step.request(now).unwrap();
        let found = model.plan(&request, &mut |_, _| false).unwrap();
        step.planned(&request, &found, taken, now).unwrap();
        indices.push(found.message.goal_index);
    }
    assert_eq!(indices, [1, 1, 1, 1, 2]);
    step.reset(None, Time::default());
    feed(&mut step, 20..=22);
    let again = step.request(at(22)).unwrap();
    assert_eq!(again.waypoint, Waypoint::default(), "from the beginning");
}

#[test]
fn goals_with_times_are_reached_at_their_times() {
    let mut step = planner();
    // Set as frame 2 is taken; one model step, two, and five.
    step.set_goal(several(&[1, 2, 5]), stamp(2));
    feed(&mut step, 0..=2);
    let request = step.request(at(2)).unwrap();
    let model = model(settings());
    let index = |request: &PlanRequest| {
        model
            .plan(request, &mut |_, _| false)
            .unwrap()
            .message
            .goal_index
    };
    assert_eq!(index(&request), 0);
    feed(&mut step, 3..=4);
    assert_eq!(index(&step.request(at(4)).unwrap()), 1);
    feed(&mut step, 5..=8);
    assert_eq!(index(&step.request(at(8)).unwrap()), 2);
}

#[test]
fn a_mask_leaves_out_what_it_does_not_mark() {
    let mut whole = goal(40);
    let mut step = planner();
    step.set_goal(whole.clone(), Time::default());
    feed(&mut step, 0..=2);
    let request = step.request(at(2)).unwrap();
    let all = model(settings()).plan(&request, &mut |_, _| false).unwrap();
    whole.mask = Some((0..16).map(|cell| f32::from(u8::from(cell == 3))).collect());
    let part = PlanRequest {
        goal: Arc::new(whole.clone()),
        ..request.clone()
    };
    let part = model(settings()).plan(&part, &mut |_, _| false).unwrap();
    assert_ne!(all.message.cost, part.message.cost);
    whole.mask = Some([1.0; 9].into());
    let wrong = PlanRequest {
        goal: Arc::new(whole),
        ..request
    };
    assert!(model(settings()).plan(&wrong, &mut |_, _| false).is_err());
}

#[test]
fn without_a_box_a_plan_does_not_wait_for_a_pose() {
    let mut step = planner_that_begins(Lead::Steps(1));
    step.set_goal(goal(40), Time::default());
    let moving = [0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    feed_moving(&mut step, 0..=2, &moving);
    assert_eq!(step.request(at(2)).unwrap().position, None);
    let mut pose = PoseStamped::default();
    pose.header.frame_id = "world".into();
    assert!(step.pose(&pose, at(2)));
    feed_moving(&mut step, 3..=4, &moving);
    let request = step.request(at(4)).unwrap();
    assert_eq!(request.position, None, "another frame");
    pose.header.frame_id = "base".into();
    assert!(step.pose(&pose, at(4)));
    feed_moving(&mut step, 5..=6, &moving);
    let [x, ..] = step.request(at(6)).unwrap().position.unwrap();
    assert!((x - 0.02).abs() < 1e-6, "{x}");
}

#[test]
fn a_box_needs_a_pose_and_keeps_the_end_effector_within() {
    let settings = |step: &PlannerStep| PlannerSettings {
        needs_pose: true,
        ..step.settings
    };
    let mut step = planner_that_begins(Lead::Steps(1));
    step.settings = settings(&step);
    step.set_goal(goal(40), Time::default());
    let moving = [0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    feed_moving(&mut step, 0..=2, &moving);
    let wait = step.request(at(2)).unwrap_err();
    assert!(wait.to_string().contains("ee_pose"), "{wait}");
    let pose = |frame_id: &str, x| {
        let mut pose = PoseStamped::default();
        pose.header.frame_id = frame_id.into();
        pose.pose.position = Point { x, y: 0.0, z: 0.1 };
        pose
    };
    assert!(!step.pose(&pose("base", f64::NAN), at(2)));
    assert!(step.pose(&pose("world", 0.3), at(2)));
    let wait = step.request(at(2)).unwrap_err().to_string();
    assert!(
        wait.contains("\"world\"") && wait.contains("\"base\""),
        "{wait}"
    );
    assert!(step.pose(&pose("base", 0.3), at(2)));
    let request = step.request(at(2)).unwrap();
    // One model step of two frames of 0.01 m until the plan begins.
    let position = request.position.unwrap();
    assert!((position[0] - 0.32).abs() < 1e-6, "{position:?}");

    let setup = |workspace| PlannerSetup {
        limits: MotionLimits {
            workspace,
            ..super::settings().limits
        },
        ..super::settings()
    };
    let end = |workspace| {
        let planned = model(setup(workspace))
            .plan(&request, &mut |_, _| false)
            .unwrap();
        let actions = planned.message.actions;
        let x: f64 = actions
            .iter()
            .map(|action| f64::from(action.values[0]))
            .sum();
        (position[0] + x, planned.message.terms)
    };
    let free = end(None).0;
    // A wall where the free plan would have gone.
    let (least, most) = match free > position[0] {
        true => (0.0, (free + position[0]) / 2.0),
        false => ((free + position[0]) / 2.0, 1.0),
    };
    let (kept, terms) = end(Some(WorkspaceBox {
        min: [least, -1.0, -1.0],
        max: [most, 1.0, 1.0],
        margin: 0.01,
        weight: 0.1,
    }));
    assert!(
        kept >= least - 1e-6 && kept <= most + 1e-6,
        "{kept}, not {least} to {most}"
    );
    assert!(terms.contains(&"workspace".to_owned()), "{terms:?}");
}

#[test]
fn words_alone_need_a_planner_that_searches() {
    let mut step = planner();
    let words = Goal {
        latents: Vec::new(),
        ..goal(40)
    };
    step.set_goal(words, Time::default());
    feed(&mut step, 0..=2);
    let request = step.request(at(2)).unwrap();
    // Nothing reads them here: only the actions cost.
    let mut setup = settings();
    setup.weights.action = 1.0;
    let found = model(setup).plan(&request, &mut |_, _| false).unwrap();
    assert_eq!(found.message.terms, ["action"]);
    assert!(found.message.distance.is_nan());
}

#[test]
fn goal_that_another_model_reads_again_goes_on_from_its_progress() {
    let mut before = planner();
    before.set_goal(several(&[]), stamp(1));
    feed(&mut before, 0..=2);
    let model = model(settings());
    let request = before.request(at(2)).unwrap();
    let found = model.plan(&request, &mut |_, _| false).unwrap();
    let taken = Duration::from_millis(1);
    before.planned(&request, &found, taken, at(2)).unwrap();
    let progress = |step: &PlannerStep| {
        let set = step.goal.as_ref().unwrap();
        (set.set_ns, set.waypoint)
    };
    assert_eq!(progress(&before).1.index, 1);

    let mut after = PlannerStep::new(before.settings, history_of(other_space()));
    assert!(!after.continue_from(&before, stamp(3)));
    assert!(!after.has_goal(), "its latents are of the other space");
    let mut third = PlannerStep::new(before.settings, history());
    third.continue_from(&after, stamp(4));
    for step in [&mut after, &mut third] {
        step.set_goal(several(&[]), stamp(5));
        assert_eq!(progress(step), progress(&before));
        step.set_goal(several(&[]), stamp(6));
        let begun = (stamp(6).to_nanos(), Waypoint::default());
        assert_eq!(progress(step), begun, "a new goal");
    }
}
