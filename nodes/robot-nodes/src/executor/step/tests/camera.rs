//! Cameras that stop.

use wm_msgs::wm_msgs::CameraState;

use super::*;

impl Bench {
    /// The encoder's report on a frame.
    fn frame(&mut self, ms: i64, frozen: bool) {
        let mut state = CameraState {
            frozen,
            ..CameraState::default()
        };
        if frozen {
            state.reason = "30 frames do not differ".into();
        }
        state.header.stamp = Time::from_nanos(START + ms * MS);
        let received = self.at(ms);
        self.step.camera(&state, received).unwrap();
    }
}

#[test]
fn a_frozen_camera_stops_the_arm_with_its_reason() {
    let mut bench = Bench::armed(settings());
    bench.frame(0, false);
    bench.set_going();
    bench.frame(440, true);
    bench.expect_stop(450);
    let status = bench.step.status();
    assert!(
        status.reason.contains("30 frames do not differ"),
        "{}",
        status.reason
    );
    assert_eq!(
        (status.hold, status.counts.interrupted),
        (Some("camera_frozen"), 1)
    );
    let (reason, text) = bench.refused(1_900, &chunk(1_900, 0.02, 9));
    assert_eq!(reason, "camera_frozen");
    assert!(text.contains("30 frames do not differ"), "{text}");
}

#[test]
fn offers_from_frames_of_the_future_are_refused() {
    let mut bench = Bench::armed(settings());
    let now = bench.at(0);
    let capture = |ms: i64| Time::from_nanos(START + ms * MS);
    // Both begin later, as they may.
    let chunk_of = |capture_ms: i64| {
        let mut chunk = chunk(1_200, 0.02, 4);
        chunk.timing.capture = capture(capture_ms);
        chunk
    };
    let plan_of = |made_ms: i64| {
        let mut plan = plan(1_200, 1);
        plan.header.stamp = capture(made_ms);
        plan
    };
    // The second one has the stamp of the chunk itself.
    for ahead_ms in [101, 1_200, 3_600_000] {
        let lead = format!("{:.2} s ahead of this node's clock", ahead_ms as f64 / 1e3);
        let (reason, text) = bench.refused(0, &chunk_of(ahead_ms));
        assert_eq!(reason, "bad_stamp");
        assert!(
            text.contains(&format!("timing.capture is stamped {lead}")),
            "{text}"
        );
        let refusal = bench.step.plan(&plan_of(ahead_ms), now, now).unwrap_err();
        assert_eq!(refusal.reason(), "bad_stamp");
        assert!(refusal.to_string().contains(&lead), "{refusal}");
    }
    assert_eq!(bench.step.status().counts.refused, 6);
    assert_eq!(bench.offer(0, &chunk_of(100)), Ok(Taken::Accepted));
    let taken = bench.step.plan(&plan_of(100), now, now);
    assert!(!matches!(taken, Err(Refusal::Future(_))), "{taken:?}");
    // A simulated clock that advances by 0.2 s at a time may be as late.
    let now = Moment {
        late_ns: 200 * MS,
        ..now
    };
    assert!(bench.step.chunk(&chunk_of(300), now, now).is_ok());
    assert!(bench.step.chunk(&chunk_of(301), now, now).is_err());
}

#[test]
fn after_a_freeze_only_offers_from_newer_frames_move_the_arm() {
    let mut bench = Bench::armed(settings());
    bench.frame(0, true);
    bench.frame(500, false);
    let mut of_plan = |made_ms: i64| {
        let mut plan = plan(600, 1);
        plan.header.stamp = Time::from_nanos(START + made_ms * MS);
        let now = bench.at(600);
        let taken = bench.step.plan(&plan, now, now);
        taken.map_err(|refusal| refusal.reason())
    };
    assert_eq!(of_plan(499), Err("frozen_frame"));
    assert_eq!(of_plan(500), Ok(Taken::Accepted));
    // A policy's chunk begins later than what it saw.
    let mut of_chunk = |capture_ms: i64| {
        let mut chunk = chunk(700, 0.02, 4);
        chunk.timing.capture = Time::from_nanos(START + capture_ms * MS);
        bench.offer(650, &chunk).map_err(|refusal| refusal.reason())
    };
    assert_eq!(of_chunk(480), Err("frozen_frame"));
    assert_eq!(of_chunk(510), Ok(Taken::Accepted));
    assert!(bench.run(650, 1_000).unwrap() > 0.09);
}

#[test]
fn a_camera_that_falls_silent_counts_as_frozen() {
    let mut bench = Bench::armed(settings());
    bench.frame(0, false);
    bench.offer(0, &chunk(0, 0.02, 20)).unwrap();
    assert!(bench.run(0, 1_000).unwrap() > 0.09);
    assert_eq!(bench.run(1_050, 1_250), Some(0.0));
    assert!(
        bench.reason().contains("camera_timeout"),
        "{}",
        bench.reason()
    );
    assert_eq!(
        bench.refused(1_300, &chunk(1_300, 0.02, 9)).0,
        "camera_silent"
    );
    bench.frame(1_400, false);
    let (reason, _) = bench.refused(1_450, &chunk(1_390, 0.02, 9));
    assert_eq!(reason, "frozen_frame");
    bench.offer(1_450, &chunk(1_450, 0.02, 9)).unwrap();
    assert!(bench.run(1_450, 1_700).unwrap() > 0.09);
}

#[test]
fn without_an_encoder_no_camera_is_waited_for() {
    let mut bench = Bench::armed(settings());
    bench.offer(0, &chunk(0, 0.02, 9)).unwrap();
    assert!(bench.run(0, 1_500).unwrap() > 0.09);
}

#[test]
fn a_reset_forgets_an_encoder_that_ended_but_no_freeze() {
    for (frozen, expected) in [(false, Ok(Taken::Accepted)), (true, Err("camera_frozen"))] {
        let mut bench = Bench::new(settings());
        bench.frame(0, frozen);
        bench.tick(5_000);
        bench.step.reset().unwrap();
        bench.step.arm().unwrap();
        let offered = bench.offer(5_050, &chunk(5_050, 0.02, 9));
        assert_eq!(offered.map_err(|refusal| refusal.reason()), expected);
    }
}
