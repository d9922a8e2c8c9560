#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use candle_core::{Device, Tensor};

use super::*;
use crate::{
    Coordinate, Dynamics, Objective, Progress, Range, SearchSpace, Target,
    testing::{BOUNDS, Point, bounds, objective, problem},
};

fn settings() -> CemSettings {
    CemSettings {
        population: 200,
        iterations: 8,
        elites: 20,
        ..Default::default()
    }
}

fn search(
    settings: CemSettings,
    (point, objective): (&mut Point, &Objective),
    proposals: Vec<Vec<Vec<f32>>>,
    seed: u64,
    watch: Watch<'_>,
) -> Result<PlannedActions, PlanError> {
    let space = bounds();
    let mut problem = problem(&space, point, objective);
    problem.proposals = proposals;
    problem.batch = 50;
    Cem::new(settings)?.plan(&mut problem, seed, watch)
}

fn plan(settings: CemSettings, objective: &Objective, seed: u64) -> PlannedActions {
    let asked = (&mut Point::new(2), objective);
    search(settings, asked, vec![], seed, &mut |_| false).unwrap()
}

#[test]
fn reaches_a_goal_within_the_bounds() {
    for returned in [Returned::BestSeen, Returned::FinalMean] {
        let settings = CemSettings {
            returned,
            ..settings()
        };
        let found = plan(settings, &objective(&[1.8, -0.9]), 1);
        let sum = |index: usize| {
            let values = found.actions.iter().map(|action| action[index]);
            values.sum::<f32>()
        };
        assert!(
            (sum(0) - 1.8).abs() < 0.05 && (sum(1) + 0.9).abs() < 0.05,
            "{found:?}"
        );
        assert!(found.cost < 1e-3 && !found.deadline_cut);
        assert_eq!(found.terms, [found.cost]);
        assert_eq!(found.iteration_costs.len(), 8);
        for action in &found.actions {
            let mut values = action.iter().zip(BOUNDS);
            assert!(values.all(|(value, (low, high))| (low..=high).contains(value)));
        }
    }
}

#[test]
fn a_goal_out_of_reach_ends_at_the_bounds() {
    let found = plan(settings(), &objective(&[9.0, 0.0]), 2);
    for action in &found.actions {
        assert!(action[0] > 0.95 && action[0] <= 1.0, "{found:?}");
    }
}

#[test]
fn target_at_each_step_fixes_the_path() {
    let way = vec![0.2_f32, 0.1, 0.9, 0.1, 0.0, 0.1];
    let way = Tensor::from_vec(way, (3, 1, 1, 2), &Device::Cpu).unwrap();
    let settings = CemSettings {
        iterations: 12,
        ..settings()
    };
    let found = plan(settings, &Objective::of(Target::EachStep(way)), 3);
    for (action, expected) in found.actions.iter().zip([0.2, 0.7, -0.9]) {
        assert!((action[0] - expected).abs() < 0.1, "{found:?}");
    }
}

#[test]
fn plan_does_not_depend_on_the_batch_size() {
    let (space, objective) = (bounds(), objective(&[0.3, 0.2]));
    let plan = |batch, seed| {
        let mut point = Point::new(2);
        let mut problem = problem(&space, &mut point, &objective);
        problem.batch = batch;
        let cem = Cem::new(settings()).unwrap();
        let found = cem.plan(&mut problem, seed, &mut |_| false).unwrap();
        assert_eq!(point.largest_batch, batch);
        found
    };
    let first = plan(64, 7);
    assert_eq!(first, plan(33, 7));
    assert_ne!(first, plan(64, 8));
}

#[test]
fn unsearched_values_keep_their_base() {
    struct Padded(Point);
    impl Dynamics for Padded {
        fn action_dim(&self) -> usize {
            5
        }
        fn start(&self) -> wm_model::Result<Tensor> {
            self.0.start()
        }
        fn rollout(&mut self, actions: &Tensor) -> wm_model::Result<Tensor> {
            let padding = actions.narrow(2, 2, 3)?.abs()?.sum_all()?;
            assert_eq!(padding.to_scalar::<f32>()?, 0.0);
            self.0.rollout(&actions.narrow(2, 0, 2)?.contiguous()?)
        }
    }
    let mut dynamics = Padded(Point::new(2));
    let space = SearchSpace::bounded(&BOUNDS, 5).unwrap();
    let mut unused = Point::new(2);
    let objective = objective(&[0.0, 0.0]);
    let mut problem = problem(&space, &mut unused, &objective);
    problem.dynamics = &mut dynamics;
    let cem = Cem::new(settings()).unwrap();
    cem.plan(&mut problem, 0, &mut |_| false).unwrap();
}

#[test]
fn plan_survives_a_deadline() {
    let objective = objective(&[1.0, 0.0]);
    let cut = |watch: Watch<'_>| {
        let asked = (&mut Point::new(2), &objective);
        search(settings(), asked, vec![], 1, watch).unwrap()
    };
    let found = cut(&mut |_| true);
    assert!(found.deadline_cut && found.candidates == 50 && found.actions.len() == 3);
    assert_eq!(found.iteration_costs.len(), 1);

    let mut told: Vec<(usize, usize)> = Vec::new();
    let found = cut(&mut |progress: &Progress<'_>| {
        told.push((progress.iteration, progress.candidates));
        told.len() > 5
    });
    // Checked at batches 2, 3, 4, at iteration 2, and at its batch 2; cut at its batch 3.
    assert_eq!(
        told,
        [(1, 50), (1, 100), (1, 150), (1, 200), (2, 250), (2, 300)]
    );
    assert!(found.deadline_cut && found.candidates == 300 && found.iteration_costs.len() == 2);
}

#[test]
fn candidates_without_finite_cost_are_rejected() {
    let objective = objective(&[2.0, 0.0]);
    let plan = |cliff: f32| {
        let mut point = Point {
            cliff,
            ..Point::new(2)
        };
        search(settings(), (&mut point, &objective), vec![], 1, &mut |_| {
            false
        })
    };
    let found = plan(0.2).unwrap();
    assert!(
        found.rejected > 0 && found.cost.is_finite() && found.actions[0][0] <= 0.2,
        "{found:?}"
    );
    let error = plan(f32::NEG_INFINITY).unwrap_err();
    assert!(
        matches!(
            error,
            PlanError::NoFiniteCost {
                iteration: 1,
                candidates: 200
            }
        ),
        "{error}"
    );
}

#[test]
fn shifted_plan_is_a_warm_start() {
    let objective = objective(&[2.4, 0.0]);
    let few = CemSettings {
        iterations: 1,
        population: 20,
        elites: 5,
        ..settings()
    };
    let good = plan(
        CemSettings {
            iterations: 10,
            ..settings()
        },
        &objective,
        1,
    );
    let left = good.without(1).unwrap();
    assert_eq!(left.actions[..2], good.actions[1..]);
    assert_eq!(
        left.actions[2], good.actions[2],
        "the last action continues"
    );
    assert_eq!(good.without(0).unwrap(), good);
    assert_eq!(good.without(3), None);
    let from = |settings: CemSettings, proposal: &[Vec<f32>]| {
        let asked = (&mut Point::new(2), &objective);
        search(settings, asked, vec![proposal.to_vec()], 5, &mut |_| false)
    };
    let warm = from(few.clone(), &good.actions).unwrap();
    assert!(warm.cost < plan(few.clone(), &objective, 5).cost / 2.0);
    let tried = CemSettings {
        try_proposals: true,
        ..few.clone()
    };
    assert!(from(tried, &good.actions).unwrap().cost <= good.cost);
    assert!(from(few, &good.actions[..2]).is_err());
}

#[test]
fn gripper_is_searched_as_one_of_two_values() {
    let gripper = Coordinate {
        index: 1,
        range: Range::Either(-0.5, 0.5),
        rate: f32::INFINITY,
    };
    let first = bounds().coordinates()[0];
    let space = SearchSpace::new(vec![0.0; 2], vec![first, gripper]).unwrap();
    // Two steps of one kind and one of the other.
    let objective = objective(&[0.0, -0.5]);
    let mut point = Point::new(2);
    let mut problem = problem(&space, &mut point, &objective);
    let cem = Cem::new(settings()).unwrap();
    let found = cem.plan(&mut problem, 4, &mut |_| false).unwrap();
    let states: Vec<f32> = found.actions.iter().map(|action| action[1]).collect();
    assert!(states.iter().all(|state| state.abs() == 0.5), "{states:?}");
    assert_eq!(states.iter().sum::<f32>(), -0.5);
}

#[test]
fn invalid_settings_are_named() {
    let refused = |settings: CemSettings| Cem::new(settings).unwrap_err().to_string();
    let elites = CemSettings {
        elites: 500,
        ..settings()
    };
    assert!(refused(elites).contains("elites"));
    let population = CemSettings {
        population: 0,
        ..settings()
    };
    assert!(refused(population).contains("population"));
    let std_floor = CemSettings {
        std_floor: f32::NAN,
        ..settings()
    };
    assert!(refused(std_floor).contains("std_floor"));
}
