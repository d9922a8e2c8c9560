//! A planner in this process, and workers as processes of their own: what one of them does to a plan, alive, slow or dead.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing)] // the helpers of tests too

mod harness;

use std::time::Duration;

use harness::{PATIENCE, Process, Scene, model, pool, worker};
use rustix::process::Signal;
use wm_planner::WorkerPool as _;
use wm_planner_worker::{Identity, PlannerWorkers};

/// Two workers, once both take part.
fn two() -> ([Process; 2], PlannerWorkers) {
    let (first, second) = (worker(), worker());
    let pool = pool(&[&first, &second], Identity::of(model()).unwrap());
    let counts = pool.wait_until(PATIENCE, |counts| counts.taking_part == 2);
    assert_eq!(counts.taking_part, 2, "{counts:?}");
    ([first, second], pool)
}

/// Plans, alone and with the workers, until these have had a part in one.
fn until_answered(pool: &PlannerWorkers, scene: &Scene) {
    let before = pool.counts().answered;
    for seed in 0.. {
        let alone = scene.plan(seed, None, &mut || {});
        assert_eq!(scene.plan(seed, Some(pool), &mut || {}), alone);
        if pool.counts().answered > before {
            return;
        }
    }
}

#[test]
fn with_two_workers_a_plan_is_the_same_to_the_bit() {
    let (_workers, pool) = two();
    let scene = Scene::new();
    until_answered(&pool, &scene);
    let counts = pool.counts();
    assert_eq!((counts.failed, counts.gone, counts.unshared), (0, 0, 0));
}

#[test]
fn a_worker_that_dies_midway_is_done_without() {
    let ([first, second], pool) = two();
    let scene = Scene::new();
    let alone = scene.plan(1, None, &mut || {});
    let (mut victim, mut place) = (Some(first), None);
    let shared = scene.plan(1, Some(&pool), &mut || {
        if let Some(victim) = victim.take() {
            place = Some(victim.kill());
        }
    });
    assert_eq!(shared, alone);
    let counts = pool.wait_until(PATIENCE, |counts| {
        (counts.gone, counts.taking_part) == (1, 1)
    });
    assert_eq!((counts.gone, counts.taking_part), (1, 1), "{counts:?}");

    // The other takes part as before, until it is told to end.
    assert_eq!(
        scene.plan(2, Some(&pool), &mut || {}),
        scene.plan(2, None, &mut || {})
    );
    second.signal(Signal::TERM);
    assert!(second.finish().success());
    let counts = pool.wait_until(PATIENCE, |counts| {
        (counts.gone, counts.taking_part) == (2, 0)
    });
    assert_eq!((counts.gone, counts.taking_part), (2, 0), "{counts:?}");
    assert_eq!(
        scene.plan(2, Some(&pool), &mut || {}),
        scene.plan(2, None, &mut || {})
    );

    // One that is started in the place of another is found by itself.
    let _third = place.unwrap().worker();
    let counts = pool.wait_until(PATIENCE, |counts| counts.taking_part == 1);
    assert_eq!(counts.taking_part, 1, "{counts:?}");
    until_answered(&pool, &scene);
}

#[test]
fn a_worker_that_is_slow_is_left_out_until_it_answers_again() {
    let ([slow, _other], pool) = two();
    let scene = Scene::new();
    let alone = scene.plan(1, None, &mut || {});
    // How long a batch takes here is known then.
    assert_eq!(scene.plan(1, Some(&pool), &mut || {}), alone);
    slow.signal(Signal::STOP);
    assert_eq!(scene.plan(1, Some(&pool), &mut || {}), alone);
    let counts = pool.wait_until(PATIENCE, |counts| counts.timed_out > 0);
    assert!(counts.timed_out > 0, "{counts:?}");
    slow.signal(Signal::CONT);
    let counts = pool.wait_until(PATIENCE, |counts| counts.taking_part == 2);
    assert_eq!(counts.taking_part, 2, "{counts:?}");
    assert_eq!(scene.plan(1, Some(&pool), &mut || {}), alone);
}

#[test]
fn a_worker_that_would_round_otherwise_takes_no_part() {
    let worker = worker();
    let mut identity = Identity::of(model()).unwrap();
    identity.fingerprint[0] ^= 1;
    let pool = pool(&[&worker], identity);
    let counts = pool.wait_until(PATIENCE, |counts| counts.refused == 1);
    assert_eq!((counts.refused, counts.taking_part), (1, 0), "{counts:?}");
    let scene = Scene::new();
    assert_eq!(
        scene.plan(1, Some(&pool), &mut || {}),
        scene.plan(1, None, &mut || {})
    );
    assert_eq!(pool.counts().answered, 0);
}

#[test]
fn a_plan_whose_workers_another_plan_has_goes_on_alone() {
    let (_workers, pool) = two();
    let scene = Scene::new();
    let lent = scene.share(&pool);
    assert!(lent.is_some() && scene.share(&pool).is_none());
    drop(lent);
    assert!(scene.share(&pool).is_some());
    let counts = pool.wait_until(Duration::ZERO, |_| true);
    assert_eq!(counts, pool.counts());
}
