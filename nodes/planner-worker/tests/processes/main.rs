//! A planner in this process, and workers as processes: effects of live, slow and dead workers on a plan.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing)] // the helpers of tests too

mod harness;

use std::time::Duration;

use harness::{PATIENCE, Process, Scene, model, pool, worker};
use rustix::process::Signal;
use wm_planner::WorkerPool as _;
use wm_planner_worker::{Identity, PlannerWorkers};

/// Two workers that have joined.
fn two() -> ([Process; 2], PlannerWorkers) {
    let (first, second) = (worker(), worker());
    let pool = pool(&[&first, &second], Identity::of(model()).unwrap());
    let counts = pool.wait_until(PATIENCE, |counts| counts.taking_part == 2);
    assert_eq!(counts.taking_part, 2, "{counts:?}");
    ([first, second], pool)
}

/// Plans alone and with the workers, until the workers have contributed.
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
fn plan_with_two_workers_is_identical_bit_for_bit() {
    let (_workers, pool) = two();
    let scene = Scene::new();
    until_answered(&pool, &scene);
    let counts = pool.counts();
    assert_eq!((counts.failed, counts.gone, counts.unshared), (0, 0, 0));
}

#[test]
fn planning_continues_without_a_dead_worker() {
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

    // The other worker continues until its end.
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

    // The planner finds a worker that replaces another.
    let _third = place.unwrap().worker();
    let counts = pool.wait_until(PATIENCE, |counts| counts.taking_part == 1);
    assert_eq!(counts.taking_part, 1, "{counts:?}");
    until_answered(&pool, &scene);
}

#[test]
fn slow_worker_is_excluded_until_it_answers() {
    let ([slow, _other], pool) = two();
    let scene = Scene::new();
    let alone = scene.plan(1, None, &mut || {});
    // The duration of a batch of the search is known now.
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
fn worker_with_different_rounding_is_rejected() {
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
fn second_plan_continues_without_workers() {
    let (_workers, pool) = two();
    let scene = Scene::new();
    let lent = scene.share(&pool);
    assert!(lent.is_some() && scene.share(&pool).is_none());
    drop(lent);
    assert!(scene.share(&pool).is_some());
    let counts = pool.wait_until(Duration::ZERO, |_| true);
    assert_eq!(counts, pool.counts());
}
