//! Invariants of environments.

use super::*;
use crate::arm::Joints;
use crate::episode::Episode;
use crate::episode_options::EpisodeOptions;
use nalgebra::Vector3;
use rand::Rng;

const SEEDS: u64 = 30;

fn environment(kind: GoalKind, seed: u64) -> Environment {
    Environment::new(kind, seed, &Variety::default()).expect("a goal that can be attained")
}

fn environments(kind: GoalKind) -> impl Iterator<Item = Environment> {
    (0..SEEDS).map(move |seed| environment(kind, seed))
}

/// Lets the oracle act until the goal is attained, at most `actions` times.
fn oracle_solves(environment: &mut Environment, actions: usize) -> bool {
    for _ in 0..actions {
        if environment.solved() {
            return true;
        }
        let action = environment.oracle();
        environment.step(&action).expect("finite");
    }
    environment.solved()
}

fn any_action(rng: &mut ChaCha8Rng) -> EndEffectorAction {
    EndEffectorAction {
        translation: Vector3::from_fn(|_, _| rng.random_range(-0.05..0.05)),
        rotation: Vector3::from_fn(|_, _| rng.random_range(-0.2..0.2)),
        gripper: f64::from(rng.random_range(0..=1_u8)),
    }
}

#[test]
fn same_seed_gives_the_same_environment() {
    for kind in GoalKind::ALL {
        let (mut first, mut second) = (environment(kind, 3), environment(kind, 3));
        assert!(first.picture() == second.picture());
        assert!(first.goal() == second.goal());
        assert_eq!(first.solution(), second.solution());
        let mut other = environment(kind, 4);
        assert!(first.picture() != other.picture());
    }
}

#[test]
fn environment_starts_as_the_episode_of_its_seed() {
    let options = EpisodeOptions {
        frames: 2,
        ..EpisodeOptions::default()
    };
    let same = (0..6)
        .filter(|seed| {
            let episode = Episode::generate(*seed, &options).expect("valid options");
            environment(GoalKind::Reach, *seed).picture() == episode.frames[0].image
        })
        .count();
    assert!(same >= 5, "{same} of 6");
}

#[test]
fn goal_kind_names_are_parsed() {
    for kind in GoalKind::ALL {
        assert_eq!(kind.to_string().parse::<GoalKind>().ok(), Some(kind));
    }
    let error = "lift".parse::<GoalKind>().expect_err("no such kind");
    assert!(error.to_string().contains("\"lift\""), "{error}");
}

#[test]
fn oracle_attains_every_goal_and_holding_still_none() {
    for kind in GoalKind::ALL {
        for mut environment in environments(kind) {
            for gripper in [0.0, 1.0] {
                environment.reset();
                for _ in 0..10 {
                    let still = EndEffectorAction::still(gripper);
                    environment.step(&still).expect("finite");
                    assert!(!environment.solved(), "{kind} {}", environment.seed());
                }
            }
            environment.reset();
            let actions = environment.solution().len();
            assert!(
                oracle_solves(&mut environment, actions),
                "{kind} {}",
                environment.seed()
            );
        }
    }
}

#[test]
fn oracle_attains_arbitrary_goals() {
    let variety = Variety::default();
    for kind in GoalKind::ALL {
        let (mut drawn, mut attained) = (0, 0);
        for seed in 0..100 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let viewer = [Vector3::x(), Vector3::y()];
            let start = layout::lay_table(&variety, &mut rng);
            let goals = (0..10).filter_map(|_| choice::draw(kind, &start, viewer, &mut rng));
            for (target, _) in goals.collect::<Vec<_>>() {
                let mut world = start.clone();
                for _ in 0..60 {
                    if let Some(action) = oracle::command(&target, &world) {
                        world.step(&action);
                    }
                }
                drawn += 1;
                attained += u32::from(target.met_by(&world));
            }
        }
        // There is no room behind some of the bowls.
        let least = if kind == GoalKind::Push { 0.9 } else { 0.99 };
        let share = f64::from(attained) / f64::from(drawn);
        println!("{kind}: {attained} of {drawn}");
        assert!(
            drawn > 50 && share >= least,
            "{kind}: {attained} of {drawn}"
        );
    }
}

#[test]
fn oracle_recovers_from_random_actions() {
    for kind in GoalKind::ALL {
        let mut recovered = 0;
        for mut environment in environments(kind) {
            let mut rng = ChaCha8Rng::seed_from_u64(environment.seed());
            for _ in 0..5 {
                for _ in 0..4 {
                    let action = environment.oracle();
                    environment.step(&action).expect("finite");
                }
                let disturbance = any_action(&mut rng);
                for _ in 0..2 {
                    environment.step(&disturbance).expect("finite");
                }
            }
            recovered += u32::from(oracle_solves(&mut environment, 60));
        }
        println!("{kind}: {recovered} of {SEEDS}");
        assert!(recovered >= 29, "{kind}: {recovered} of {SEEDS}");
    }
}

#[test]
fn goal_shows_the_end_of_the_solution() {
    for kind in GoalKind::ALL {
        for mut environment in environments(kind).take(6) {
            let goal = environment.goal().clone();
            assert!(goal.target.met_by(&goal.world));
            assert!(goal.picture != environment.picture());
            assert!(environment.picture_of(&goal.world) == goal.picture);
            for action in environment.solution().to_vec() {
                environment.step(&action).expect("finite");
                let holds = environment.world().held().is_some();
                assert!(!(holds && environment.solved()), "held is not put down");
            }
            assert!(environment.world() == &goal.world);
        }
    }
}

#[test]
fn subgoals_lead_along_the_solution_to_the_goal() {
    let mut environment = environment(GoalKind::PickPlace, 1);
    let length = environment.solution().len();
    for every in [1, 4, length, length + 1] {
        let every = NonZeroUsize::new(every).expect("positive");
        let subgoals = environment.subgoals(every);
        assert_eq!(subgoals.len(), length.div_ceil(every.get()));
        let last = subgoals.last().expect("one at least");
        assert_eq!(last.step, length);
        assert!(last.picture == environment.goal().picture);
        let first = &subgoals[0];
        environment.reset();
        let actions = environment.solution()[..first.step].to_vec();
        for action in &actions {
            environment.step(action).expect("finite");
        }
        assert!(environment.world() == &first.world);
        assert!(environment.picture() == first.picture);
    }
}

#[test]
fn imagine_predicts_steps_and_changes_nothing() {
    let mut environment = environment(GoalKind::Push, 2);
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let actions: Vec<_> = (0..6).map(|_| any_action(&mut rng)).collect();
    environment.step(&actions[0]).expect("finite");
    let (before, picture) = (environment.world().clone(), environment.picture());
    let imagined = environment.imagine(&actions).expect("finite");
    assert!(environment.world() == &before && environment.steps() == 1);
    assert!(environment.picture() == picture);
    assert_eq!(imagined.len(), actions.len());
    for (action, imagined) in actions.iter().zip(&imagined) {
        environment.step(action).expect("finite");
        let seen = Snapshot {
            step: environment.steps(),
            world: environment.world().clone(),
            picture: environment.picture(),
        };
        assert!(imagined == &seen);
    }
}

#[test]
fn step_returns_the_actual_motion() {
    let mut environment = environment(GoalKind::PickPlace, 0);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..40 {
        let before = *environment.world().tool();
        let action = any_action(&mut rng);
        let taken = environment.step(&action).expect("finite");
        let after = environment.world().tool();
        assert!((after.position - before.position - taken.translation).norm() < 1e-12);
        assert!((after.rpy - before.rpy - taken.rotation).norm() < 1e-12);
        let joints = environment.joint_positions().expect("within reach");
        let [arm @ .., left, right] = joints;
        let tool = arm::forward(&Joints(arm)).tool.translation.vector;
        assert!((tool - after.position).norm() < 1e-9);
        assert!(left + right == 0.0 && left == environment.world().opening() * HALF_OPENING_M);
    }
    assert_eq!(environment.steps(), 40);
    assert!((environment.time_s() - 8.0).abs() < 1e-9);
}

#[test]
fn actions_are_limited_and_nan_is_rejected() {
    let mut environment = environment(GoalKind::Reach, 0);
    let start = environment.world().clone();
    for (at, value) in [(0, f32::NAN), (4, f32::INFINITY), (6, f32::NEG_INFINITY)] {
        let mut values = [0.01; 7];
        values[at] = value;
        let action = EndEffectorAction::from_values(values);
        let refused = environment.step(&action);
        assert!(matches!(refused, Err(Error::Action { .. })), "{values:?}");
        assert!(environment.imagine(&[action]).is_err());
    }
    assert!(environment.world() == &start && environment.steps() == 0);
    // Towards the middle of the workspace: only the size limits it.
    let middle = Vector3::new(0.27, 0.0, 0.08) - start.tool().position;
    let far = EndEffectorAction {
        translation: middle.map(|v| 1e3 * v.signum()),
        rotation: start.tool().rpy.map(|v| -1e3 * v.signum()),
        gripper: 7.0,
    };
    let taken = environment.step(&far).expect("finite");
    assert!(
        (taken.translation.amax() - LARGEST_STEP_M).abs() < 1e-9,
        "{taken:?}"
    );
    assert!(
        (taken.rotation.amax() - LARGEST_TURN_RAD).abs() < 1e-9,
        "{taken:?}"
    );
    assert_eq!(taken.gripper, 1.0);
}

#[test]
fn tables_without_a_possible_goal_are_an_error() {
    let variety = Variety {
        object_counts: [1.0, 0.0, 0.0, 0.0],
        mat_share: 0.0,
        ..Variety::default()
    };
    let refused = Environment::new(GoalKind::PickPlace, 5, &variety);
    assert!(matches!(
        refused.err(),
        Some(Error::Unsolvable { seed: 5, .. })
    ));
}

#[test]
fn attained_goal_fulfils_the_instruction() {
    for kind in GoalKind::ALL {
        for mut environment in environments(kind) {
            let seed = environment.seed();
            // An object to push has not moved yet; a reach or a placement may be fulfilled from the start.
            assert!(!(kind == GoalKind::Push && environment.instruction_followed()));
            assert!(oracle_solves(&mut environment, 100), "{kind} {seed}");
            assert!(environment.instruction_followed(), "{kind} {seed}");
        }
    }
}

#[test]
fn oracle_for_another_target_attains_it() {
    for mut environment in environments(GoalKind::Reach) {
        let Target::Tool { position } = environment.goal().target else {
            panic!("a reach brings the tool somewhere");
        };
        let other = Target::Tool {
            position: position.map(|value| value * 0.9),
        };
        assert_eq!(
            environment.oracle(),
            environment.oracle_for(&environment.goal().target)
        );
        for _ in 0..30 {
            let action = environment.oracle_for(&other);
            environment.step(&action).expect("finite");
        }
        assert!(other.met_by(environment.world()), "{}", environment.seed());
    }
}
