#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use super::*;

/// A point that moves by its actions: the latent (1, 1, A) after step k is the sum of the first k actions.
struct Point {
    values: usize,
    largest_batch: usize,
    /// The latent is NaN where the first action's first value is above this.
    cliff: f32,
}

impl Point {
    fn new(values: usize) -> Self {
        Self {
            values,
            largest_batch: 0,
            cliff: f32::INFINITY,
        }
    }
}

impl Dynamics for Point {
    fn action_dim(&self) -> usize {
        self.values
    }

    fn rollout(&mut self, actions: &Tensor) -> crate::Result<Tensor> {
        let (count, steps, values) = actions.dims3()?;
        assert_eq!(values, self.values);
        self.largest_batch = self.largest_batch.max(count);
        let mut out = Vec::new();
        for candidate in actions.to_vec3::<f32>()? {
            let mut place = vec![0.0; values];
            for action in &candidate {
                place
                    .iter_mut()
                    .zip(action)
                    .for_each(|(place, delta)| *place += delta);
                let fallen = candidate[0][0] > self.cliff;
                out.extend(
                    place
                        .iter()
                        .map(|value| if fallen { f32::NAN } else { *value }),
                );
            }
        }
        Ok(Tensor::from_vec(
            out,
            (count, steps, 1, 1, values),
            &Device::Cpu,
        )?)
    }
}

fn goal(values: &[f32]) -> Target {
    Target::LastStep(Tensor::from_vec(values.to_vec(), (1, 1, values.len()), &Device::Cpu).unwrap())
}

fn settings() -> CemSettings {
    CemSettings {
        population: 200,
        iterations: 8,
        elites: 20,
        horizon: 3,
        ..Default::default()
    }
}

const BOUNDS: [(f32, f32); 2] = [(-1.0, 1.0), (-0.5, 0.5)];

fn plan(settings: CemSettings, target: &Target, seed: u64) -> PlannedActions {
    Cem::new(settings, &BOUNDS)
        .unwrap()
        .plan(&mut Point::new(2), target, None, seed, &mut || false)
        .unwrap()
}

#[test]
fn reaches_a_goal_within_the_bounds() {
    for returned in [Returned::BestSeen, Returned::FinalMean] {
        let found = plan(
            CemSettings {
                returned,
                ..settings()
            },
            &goal(&[1.8, -0.9]),
            1,
        );
        let sum = |index: usize| {
            found
                .actions
                .iter()
                .map(|action| action[index])
                .sum::<f32>()
        };
        assert!(
            (sum(0) - 1.8).abs() < 0.05 && (sum(1) + 0.9).abs() < 0.05,
            "{found:?}"
        );
        assert!(found.cost < 1e-3 && !found.deadline_cut);
        assert_eq!(found.iteration_costs.len(), 8);
        for action in &found.actions {
            assert!(
                action
                    .iter()
                    .zip(BOUNDS)
                    .all(|(value, (low, high))| (low..=high).contains(value))
            );
        }
    }
}

#[test]
fn a_goal_out_of_reach_ends_at_the_bounds() {
    let found = plan(settings(), &goal(&[9.0, 0.0]), 2);
    for action in &found.actions {
        assert!(action[0] > 0.95 && action[0] <= 1.0, "{found:?}");
    }
}

#[test]
fn target_at_each_step_fixes_the_way() {
    let way = Tensor::from_vec(
        vec![0.2_f32, 0.1, 0.9, 0.1, 0.0, 0.1],
        (3, 1, 1, 2),
        &Device::Cpu,
    )
    .unwrap();
    let found = plan(
        CemSettings {
            iterations: 12,
            ..settings()
        },
        &Target::EachStep(way),
        3,
    );
    for (action, expected) in found.actions.iter().zip([0.2, 0.7, -0.9]) {
        assert!((action[0] - expected).abs() < 0.1, "{found:?}");
    }
}

#[test]
fn one_seed_one_plan_whatever_the_batch() {
    let first = plan(settings(), &goal(&[0.3, 0.2]), 7);
    let again = plan(
        CemSettings {
            batch: 33,
            ..settings()
        },
        &goal(&[0.3, 0.2]),
        7,
    );
    assert_eq!(first, again);
    assert_ne!(first, plan(settings(), &goal(&[0.3, 0.2]), 8));
}

#[test]
fn batches_are_bounded_and_padding_is_zero() {
    struct Padded(Point);
    impl Dynamics for Padded {
        fn action_dim(&self) -> usize {
            5
        }
        fn rollout(&mut self, actions: &Tensor) -> crate::Result<Tensor> {
            let padding = actions
                .narrow(2, 2, 3)?
                .abs()?
                .sum_all()?
                .to_scalar::<f32>()?;
            assert_eq!(padding, 0.0);
            self.0.rollout(&actions.narrow(2, 0, 2)?.contiguous()?)
        }
    }
    let mut dynamics = Padded(Point::new(2));
    let cem = Cem::new(
        CemSettings {
            batch: 48,
            ..settings()
        },
        &BOUNDS,
    )
    .unwrap();
    cem.plan(&mut dynamics, &goal(&[0.0, 0.0]), None, 0, &mut || false)
        .unwrap();
    assert_eq!(dynamics.0.largest_batch, 48);
}

#[test]
fn a_deadline_cuts_but_leaves_a_plan() {
    let cem = Cem::new(
        CemSettings {
            batch: 50,
            ..settings()
        },
        &BOUNDS,
    )
    .unwrap();
    let found = cem
        .plan(&mut Point::new(2), &goal(&[1.0, 0.0]), None, 1, &mut || {
            true
        })
        .unwrap();
    assert!(found.deadline_cut && found.candidates == 50 && found.actions.len() == 3);
    assert_eq!(found.iteration_costs.len(), 1);

    let mut asked = 0;
    let mut later = || {
        asked += 1;
        asked > 5
    };
    let found = cem
        .plan(&mut Point::new(2), &goal(&[1.0, 0.0]), None, 1, &mut later)
        .unwrap();
    // Asked before batches 2, 3, 4, then before iteration 2, then batch 2 of it; cut before batch 3 of it.
    assert!(found.deadline_cut && found.candidates == 300 && found.iteration_costs.len() == 2);
}

#[test]
fn costs_that_are_not_finite_are_rejected() {
    let cem = Cem::new(settings(), &BOUNDS).unwrap();
    let mut cliff = Point {
        cliff: 0.2,
        ..Point::new(2)
    };
    let found = cem
        .plan(&mut cliff, &goal(&[2.0, 0.0]), None, 1, &mut || false)
        .unwrap();
    assert!(
        found.rejected > 0 && found.cost.is_finite() && found.actions[0][0] <= 0.2,
        "{found:?}"
    );

    let mut nowhere = Point {
        cliff: f32::NEG_INFINITY,
        ..Point::new(2)
    };
    let error = cem
        .plan(&mut nowhere, &goal(&[2.0, 0.0]), None, 1, &mut || false)
        .unwrap_err();
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
fn a_shifted_plan_is_a_warm_start() {
    let target = goal(&[2.4, 0.0]);
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
        &target,
        1,
    );
    let left = good.without(1).unwrap();
    assert_eq!(left.actions[..2], good.actions[1..]);
    assert_eq!(
        left.actions[2], good.actions[2],
        "it goes on with its last action"
    );
    assert_eq!(good.without(0).unwrap(), good);
    assert_eq!(good.without(3), None);
    let cem = Cem::new(few.clone(), &BOUNDS).unwrap();
    let warm = cem
        .plan(
            &mut Point::new(2),
            &target,
            Some(&good.actions),
            5,
            &mut || false,
        )
        .unwrap();
    assert!(warm.cost < plan(few, &target, 5).cost / 2.0);
    assert!(
        cem.plan(
            &mut Point::new(2),
            &target,
            Some(&good.actions[..2]),
            5,
            &mut || false
        )
        .is_err()
    );
}

#[test]
fn settings_are_refused_by_name() {
    let refused = |settings: CemSettings| Cem::new(settings, &BOUNDS).unwrap_err().to_string();
    assert!(
        refused(CemSettings {
            elites: 500,
            ..settings()
        })
        .contains("elites")
    );
    assert!(
        refused(CemSettings {
            population: 0,
            ..settings()
        })
        .contains("population")
    );
    assert!(
        refused(CemSettings {
            std_floor: f32::NAN,
            ..settings()
        })
        .contains("std_floor")
    );
    let inverted = Cem::new(settings(), &[(1.0, -1.0)])
        .unwrap_err()
        .to_string();
    assert!(inverted.contains("1..-1"), "{inverted}");
}
