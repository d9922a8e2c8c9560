//! Clocks that stop, are slow, or jump.

use super::*;

/// A moment whose clock stopped at `stamp_ms`.
fn stopped(bench: &Bench, ms: i64, stamp_ms: i64) -> Moment {
    Moment {
        stamp_ns: START + stamp_ms * MS,
        ..bench.at(ms)
    }
}

/// The distance that is commanded from a time on while the clock reads `stamp_ms`, and when the last motion was \[m, ms\].
fn distance(bench: &mut Bench, from_ms: i64, stamp_ms: impl Fn(i64) -> i64) -> (f64, i64) {
    let (mut metres, mut last_ms) = (0.0, from_ms);
    for ms in (from_ms..from_ms + 20_000).step_by(50) {
        let now = stopped(bench, ms, stamp_ms(ms));
        let forward = sent(bench.step.tick(now).output).unwrap_or(0.0);
        metres += forward.abs() * 0.05;
        if forward != 0.0 {
            last_ms = ms;
        }
    }
    (metres, last_ms)
}

#[test]
fn a_stopped_clock_stops_the_arm_within_max_age() {
    let mut bench = Bench::moving(settings());
    let (metres, last_ms) = distance(&mut bench, 450, |_| 400);
    assert!(last_ms <= 400 + 1_750, "{last_ms} ms");
    assert!(metres < 0.18, "{metres} m");
    let reason = bench.reason();
    assert!(reason.contains("/clock has not advanced"), "{reason}");
    assert_eq!(bench.step.status().hold, Some("clock_stopped"));
}

#[test]
fn a_stopped_clock_stops_a_fast_arm_within_a_short_max_age() {
    for max_age_ms in [300, 350, 399, 600] {
        let mut settings = settings();
        settings.max_age = Duration::from_millis(max_age_ms);
        let timeout = ClockWatch::timeout_for(
            Duration::from_millis(1_500),
            settings.max_age,
            settings.stop_within,
            settings.period,
        );
        settings.clock = ClockWatch::new(timeout);
        let mut bench = Bench::armed(settings);
        // At the greatest velocity.
        for ms in (0..=400).step_by(50) {
            bench.offer(ms, &chunk(ms, 0.05, 20)).unwrap();
            bench.tick(ms);
        }
        let mut last_ms = 400;
        for ms in (450..3_000).step_by(50) {
            // It stops 1 ms after the last command.
            let now = stopped(&bench, ms, 401);
            // A policy without a clock of its own goes on.
            bench.step.chunk(&chunk(401, 0.05, 20), now, now).ok();
            if sent(bench.step.tick(now).output).unwrap_or(0.0) != 0.0 {
                last_ms = ms;
            }
        }
        // A command holds for a period.
        let moved_ms = last_ms + PERIOD_MS - 401;
        assert!(moved_ms > 50, "{moved_ms} ms");
        assert!(moved_ms.unsigned_abs() <= max_age_ms, "{moved_ms} ms");
        assert!(bench.reason().contains("/clock"), "{}", bench.reason());
    }
}

/// Neither the offer that is executed nor the next one outlives its age.
#[test]
fn a_chunk_ahead_of_a_stopped_clock_soon_ends() {
    let mut bench = Bench::armed(settings());
    bench.tick(0);
    // It begins within a command period.
    bench.offer(0, &chunk(30, 0.02, 20)).unwrap();
    let now = stopped(&bench, 50, 0);
    // It begins 20 ms before the end of the period.
    let forward = sent(bench.step.tick(now).output).unwrap();
    assert!((forward - 0.04).abs() < 1e-6, "{forward}");
    assert_eq!(bench.state(), State::Executing);
    let (metres, last_ms) = distance(&mut bench, 100, |_| 0);
    assert!(last_ms <= 2_000, "{last_ms} ms");
    assert!(metres < 0.1, "{metres} m");
    assert!(bench.reason().contains("/clock"), "{}", bench.reason());
}

#[test]
fn new_chunks_do_not_move_the_arm_while_the_clock_stands() {
    let mut bench = Bench::moving(settings());
    let mut metres = 0.0;
    let mut refused = "";
    for ms in (450..20_000).step_by(50) {
        let now = stopped(&bench, ms, 400);
        if ms % 200 == 0 {
            // A policy without a clock of its own.
            let offered = bench.step.chunk(&chunk(400, 0.02, 20), now, now);
            refused = offered.map_or_else(|refusal| refusal.reason(), |_| "");
        }
        metres += sent(bench.step.tick(now).output).unwrap_or(0.0) * 0.05;
    }
    assert!(metres < 0.18, "{metres} m");
    assert_eq!(refused, "clock_stopped");
    // It goes on, and a new chunk is needed.
    assert_eq!(bench.run(20_000, 20_200), None);
    bench.offer(20_250, &chunk(20_250, 0.02, 20)).unwrap();
    assert!(bench.run(20_250, 20_500).unwrap() > 0.09);
}

#[test]
fn a_plan_is_not_executed_longer_than_max_age_by_either_clock() {
    for is_real in [true, false] {
        let mut bench = Bench::armed(settings());
        let mut long = plan(0, 1);
        long.actions = chunk(0, 0.02, 30).actions;
        let now = bench.at(0);
        bench.step.plan(&long, now, now).unwrap();
        let mut last_ms = 0;
        for tick in 0..100 {
            // The other clock is a third as fast.
            let (fast, slow) = (tick * 50, tick * 50 / 3);
            let now = match is_real {
                true => stopped(&bench, fast, slow),
                false => stopped(&bench, slow, fast),
            };
            if sent(bench.step.tick(now).output).unwrap_or(0.0) != 0.0 {
                last_ms = fast;
            }
        }
        assert!(last_ms <= 2_100, "{last_ms} ms");
        assert!(bench.reason().contains("max_age"), "{}", bench.reason());
    }
}

#[test]
fn a_slow_clock_does_not_lengthen_the_motion_of_a_chunk() {
    let mut bench = Bench::armed(settings());
    // 0.08 m in 0.8 s.
    bench.offer(0, &chunk(0, 0.02, 4)).unwrap();
    let (metres, last_ms) = distance(&mut bench, 0, |ms| ms / 10);
    assert!(last_ms <= 1_300, "{last_ms} ms");
    assert!(metres < 0.12, "{metres} m");
    let reason = bench.reason();
    assert!(reason.contains("by real time"), "{reason}");
}

#[test]
fn a_clock_that_jumps_past_the_chunk_stops_the_arm_by_name() {
    for ahead_ms in [3_600, 20_000] {
        let mut bench = Bench::moving(settings());
        let now = stopped(&bench, 450, 450 + ahead_ms);
        let forward = sent(bench.step.tick(now).output).unwrap();
        assert!(forward < 0.1, "{forward}");
        let reason = bench.reason();
        assert!(reason.contains("the clock jumped ahead by"), "{reason}");
        assert_eq!(bench.step.status().counts.interrupted, 1);
    }
}

#[test]
fn a_chunk_that_the_clock_jumps_past_is_counted() {
    let mut bench = Bench::armed(settings());
    bench.tick(0);
    bench.offer(0, &chunk(1_000, 0.02, 2)).unwrap();
    let now = stopped(&bench, 50, 1_500);
    let tick = bench.step.tick(now);
    assert_eq!(sent(tick.output), None);
    assert!(matches!(tick.refused[..], [Refusal::Late { .. }]));
    assert_eq!(bench.step.status().counts.refused, 1);
}

#[test]
fn a_clock_that_jumps_back_stops_it_and_all_is_forgotten() {
    let mut bench = Bench::moving(settings());
    let now = stopped(&bench, 450, -10_000);
    let forward = sent(bench.step.tick(now).output).unwrap();
    assert!(forward < 0.1, "{forward}");
    assert_eq!(bench.state(), State::Stopping);
    assert!(bench.reason().contains("clock"), "{}", bench.reason());
    assert_eq!(bench.run(500, 1100), None);
    assert_eq!(bench.state(), State::DryRun);
}

#[test]
fn a_plan_of_a_newer_epoch_ends_an_older_one() {
    let mut bench = Bench::armed(settings());
    let mut offer = |ms: i64, plan: &Plan| {
        let now = bench.at(ms);
        bench
            .step
            .plan(plan, now, now)
            .map(|_| bench.run(ms, ms + 100))
    };
    let mut old = plan(0, 7);
    old.actions = chunk(0, 0.02, 8).actions;
    assert!(offer(0, &old).unwrap().unwrap() > 0.0);
    // Its own actions begin later.
    let stopping = offer(150, &plan(1_000, 8)).unwrap().unwrap();
    assert_eq!(stopping, 0.0);
    assert!(bench.reason().contains("reset"), "{}", bench.reason());
    assert_eq!(bench.step.status().counts.interrupted, 1);
    assert!(bench.run(300, 1_200).unwrap() > 0.09);
}
