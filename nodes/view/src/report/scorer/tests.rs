use super::*;
use image::Rgb;
use wm_msgs::{
    builtin_interfaces::{Duration, Time},
    diagnostic_msgs::{DiagnosticStatus, KeyValue},
    std_msgs::Header,
};

const STEP_NS: i64 = 400_000_000;
const FRAME_NS: i64 = STEP_NS / 2;

fn header(stamp_ns: i64) -> Header {
    Header {
        stamp: Time::from_nanos(stamp_ns),
        ..Header::default()
    }
}

fn prediction(observed_ns: i64, step: u32, ready_ns: i64) -> Prediction {
    Prediction {
        header: header(observed_ns + i64::from(step) * STEP_NS),
        observed_stamp: Time::from_nanos(observed_ns),
        step,
        horizon: 2,
        step_period: Duration::from_nanos(STEP_NS),
        ready_stamp: Time::from_nanos(ready_ns),
        model: "tiny".to_owned(),
        ..Prediction::default()
    }
}

/// A 16x16 picture of one grey level.
fn grey(level: u8) -> RgbImage {
    RgbImage::from_pixel(16, 16, Rgb([level; 3]))
}

/// The camera brightens by 10 levels per frame; predictions are off by `error` levels.
fn run(scorer: &mut Scorer, frames: i64, error: u8) {
    for frame in 0..frames {
        let now = frame * FRAME_NS;
        scorer.frame(
            now,
            RgbImage::from_pixel(32, 32, Rgb([100 + 10 * frame as u8; 3])),
        );
        for step in 1..=2_u32 {
            let arrived = now + 30_000_000 + i64::from(step) * 5_000_000;
            scorer.prediction(&prediction(now, step, arrived - 1_000_000), arrived);
            let level = 100 + 10 * (frame as u8 + 2 * step as u8) + error;
            scorer.picture(
                now + i64::from(step) * STEP_NS,
                grey(level),
                arrived + 10_000_000,
            );
        }
    }
}

#[test]
fn prediction_without_a_period_is_counted() {
    let mut scorer = Scorer::default();
    scorer.frame(0, grey(0));
    let broken = Prediction {
        step_period: Duration::from_nanos(-1_000),
        ..prediction(0, 1, 1)
    };
    scorer.prediction(&broken, 2);
    scorer.picture(STEP_NS, grey(0), 3);
    scorer.picture(0, grey(0), 4);
    assert_eq!(scorer.drop_count(), 1);
}

#[test]
fn prediction_with_an_invalid_time_is_counted() {
    let changes: [fn(&mut Prediction); 4] = [
        |prediction| prediction.header.stamp.nanosec = 1_000_000_000,
        |prediction| prediction.observed_stamp.nanosec = u32::MAX,
        |prediction| prediction.ready_stamp.nanosec = 1_000_000_000,
        |prediction| prediction.step_period.nanosec = 1_000_000_000,
    ];
    let mut scorer = Scorer::default();
    for change in changes {
        let mut invalid = prediction(STEP_NS, 1, STEP_NS);
        change(&mut invalid);
        scorer.prediction(&invalid, STEP_NS);
    }
    assert_eq!(scorer.drop_count(), 4);
    assert!(scorer.steps.is_empty());
}

#[test]
fn pictures_and_baseline_are_compared_with_the_same_frame() {
    let mut scorer = Scorer::default();
    run(&mut scorer, 10, 2);
    let report = scorer.report("test");
    assert_eq!(
        (report.frames, report.observations, report.horizon),
        (10, 10, 2)
    );
    assert!((report.frame_rate_hz - 5.0).abs() < 1e-9);
    let [first, second] = report.steps.as_slice() else {
        panic!("{} steps", report.steps.len())
    };
    // k=1 is two frames ahead, k=2 four: so many of the ten have a frame to compare with
    assert_eq!(
        (first.predictions, first.compared, first.missing),
        (10, 8, 0)
    );
    assert_eq!((second.predictions, second.compared), (10, 6));
    let decibel = |levels: f64| 20.0 * (255.0 / levels).log10();
    assert!((first.psnr_db.unwrap() - decibel(2.0)).abs() < 1e-9);
    assert!((first.persistence_psnr_db.unwrap() - decibel(20.0)).abs() < 1e-9);
    assert!((second.persistence_psnr_db.unwrap() - decibel(40.0)).abs() < 1e-9);
    assert!(first.ssim.unwrap() > first.persistence_ssim.unwrap());
    assert!((first.ready_latency.unwrap().p50_ms - 34.0).abs() < 0.5);
    assert!((second.received_latency.unwrap().p95_ms - 40.0).abs() < 0.5);
}

#[test]
fn lost_picture_is_not_replaced_by_another_observations() {
    let mut scorer = Scorer::default();
    for frame in 0..4 {
        scorer.frame(frame * FRAME_NS, grey(100));
    }
    // both predict the time 800 ms; the picture of the first was lost
    let moment = 2 * STEP_NS;
    scorer.prediction(&prediction(0, 2, 1), 10_000_000);
    scorer.prediction(&prediction(STEP_NS, 1, 1), STEP_NS + 20_000_000);
    scorer.picture(moment, grey(103), STEP_NS + 40_000_000);
    scorer.frame(moment, grey(100));
    let report = scorer.report("test");
    assert_eq!(
        report
            .steps
            .iter()
            .map(|step| step.compared)
            .collect::<Vec<_>>(),
        [1, 0]
    );
    assert_eq!(report.steps[0].missing, 1);
}

#[test]
fn skipped_rollout_gets_no_pictures_of_the_next() {
    let mut scorer = Scorer::default();
    for frame in 0..3 {
        scorer.frame(frame * FRAME_NS, grey(100));
    }
    // A late rollout without pictures, then one with pictures: its first picture has the same time.
    scorer.prediction(&prediction(0, 2, 1), 160_000_000);
    scorer.prediction(&prediction(STEP_NS, 1, 1), STEP_NS + 50_000_000);
    scorer.picture(2 * STEP_NS, grey(100), STEP_NS + 90_000_000);
    // A rollout with a picture gets the next one, although a newer prediction has that time.
    scorer.prediction(&prediction(STEP_NS, 2, 1), STEP_NS + 160_000_000);
    scorer.prediction(&prediction(2 * STEP_NS, 1, 1), 2 * STEP_NS + 50_000_000);
    scorer.picture(3 * STEP_NS, grey(100), 2 * STEP_NS + 90_000_000);
    for frame in 3..7 {
        scorer.frame(frame * FRAME_NS, grey(100));
    }
    let report = scorer.report("test");
    let compared: Vec<_> = report.steps.iter().map(|step| step.compared).collect();
    assert_eq!(compared, [1, 1]);
}

#[test]
fn late_picture_of_an_unknown_prediction_is_only_counted() {
    let mut scorer = Scorer::default();
    scorer.frame(0, grey(100));
    scorer.prediction(&prediction(-STEP_NS, 2, 1), 9_000_000 - STEP_NS);
    scorer.prediction(&prediction(0, 1, 1), 10_000_000);
    scorer.picture(STEP_NS, grey(100), 11_000_000 + STEP_NS);
    scorer.frame(STEP_NS, grey(100));
    let report = scorer.report("test");
    assert_eq!((report.steps[0].compared, scorer.drop_count()), (0, 1));
}

#[test]
fn rollout_with_the_most_motion_is_shown() {
    let mut scorer = Scorer::default();
    // still, then a jump at frame 6; one brighter pixel tells the frames apart
    for frame in 0..10_u32 {
        let now = i64::from(frame) * FRAME_NS;
        let mut picture = grey(if frame < 6 { 50 } else { 200 });
        picture.put_pixel(frame, 1, image::Rgb([51; 3]));
        scorer.frame(now, picture);
        for step in 1..=2 {
            scorer.prediction(&prediction(now, step, now), now + 1);
            scorer.picture(now + i64::from(step) * STEP_NS, grey(60), now + 2);
        }
    }
    let shown = scorer.shown_rollout().unwrap();
    // from frames 4 and 5 both steps are past the jump; the first of the two stays
    assert_eq!(shown.observed.get_pixel(4, 1).0, [51; 3]);
    assert_eq!(shown.observed.get_pixel(5, 1).0, [50; 3]);
    assert_eq!(shown.steps.len(), 2);
    assert_eq!(shown.steps[&1].0.get_pixel(0, 0).0, [200; 3]);
}

/// A decoder under load skips pictures: no rollout is complete.
#[test]
fn rollout_with_gaps_is_shown_if_none_is_complete() {
    let mut scorer = Scorer::default();
    for frame in 0..10 {
        let now = frame * FRAME_NS;
        scorer.frame(now, grey(50));
        for step in 1..=2 {
            scorer.prediction(&prediction(now, step, now), now + 1);
        }
        scorer.picture(now + 2 * STEP_NS, grey(60), now + 2);
    }
    let shown = scorer.shown_rollout().unwrap();
    assert_eq!(shown.steps.keys().collect::<Vec<_>>(), [&2]);
    // a jump back in time closes the open rollouts
    scorer.frame(0, grey(1));
    assert!(scorer.shown_rollout().is_some());
}

#[test]
fn pictures_without_frames_are_dropped_and_time_jumps_flush() {
    let mut scorer = Scorer::default();
    scorer.frame(0, grey(1));
    scorer.prediction(&prediction(0, 1, 1), 1);
    scorer.picture(STEP_NS, grey(1), 2);
    assert_eq!(scorer.waiting.len(), 1);
    scorer.frame(STEP_NS + FRAME_NS, grey(1));
    assert_eq!(scorer.waiting.len(), 0);
    scorer.frame(10 * STEP_NS, grey(1));
    scorer.frame(0, grey(1));
    assert_eq!(scorer.frames.newest_ns(), Some(0));
    assert_eq!(scorer.report("test").steps[0].compared, 0);
}

#[test]
fn waiting_pictures_are_bounded() {
    let mut scorer = Scorer::default();
    scorer.frame(0, grey(1));
    for index in 0..5000_i64 {
        scorer.prediction(&prediction(index * 1000, 1, 1), index);
        scorer.picture(index * 1000 + STEP_NS, grey(1), index);
        scorer.prediction(&prediction(index * 1000, 2, 1), index);
    }
    assert_eq!(
        (scorer.pairings.waiting(), scorer.waiting.len()),
        (WAITING_LIMIT, WAITING_LIMIT)
    );
}

#[test]
fn latent_errors_plans_and_drops_are_summed() {
    let mut scorer = Scorer::default();
    for (mse, persistence_mse, ratio) in
        [(1.0, 2.0, 0.5), (2.0, 10.0, 0.2), (f32::NAN, 0.0, f32::NAN)]
    {
        scorer.error(&PredictionError {
            step: 1,
            mse,
            persistence_mse,
            ratio,
            ..PredictionError::default()
        });
    }
    assert_eq!(scorer.last_error_ratio(), Some(0.2));
    let plan = |cost, deadline_cut| Plan {
        cost,
        deadline_cut,
        time_taken: Duration::from_nanos(50_000_000),
        ..Plan::default()
    };
    scorer.plan(&plan(3.0, false));
    scorer.plan(&plan(1.0, true));
    let value = |key: &str, value: &str| KeyValue {
        key: key.to_owned(),
        value: value.to_owned(),
    };
    let values = vec![
        value("dropped: late [total]", "4"),
        value("dropped: odd [total]", "x"),
        value("skipped: pace [total]", "7"),
        value("received: odd [total]", "9"),
        value("sent", "9"),
    ];
    let status = DiagnosticStatus {
        name: "wm/encoder".to_owned(),
        values,
        ..DiagnosticStatus::default()
    };
    let array = DiagnosticArray {
        status: vec![status],
        ..DiagnosticArray::default()
    };
    scorer.diagnostics(&array);
    scorer.diagnostics(&array);
    assert_eq!(scorer.drop_count(), 4);
    let report = scorer.report("test");
    assert!((report.steps[0].latent_error_ratio.unwrap() - 0.25).abs() < 1e-9);
    let plans = report.plans.unwrap();
    assert_eq!(
        (
            plans.plans,
            plans.deadline_cuts,
            plans.first_cost,
            plans.last_cost
        ),
        (2, 1, 3.0, 1.0)
    );
    let totals = |counts: &[Drops]| counts.iter().map(|drops| drops.total).collect::<Vec<_>>();
    assert_eq!(
        (totals(&report.drops), totals(&report.skips)),
        (vec![4], vec![7])
    );
}

#[test]
fn scorer_is_empty_before_the_first_message() {
    let mut scorer = Scorer::default();
    scorer.diagnostics(&DiagnosticArray::default());
    assert!(scorer.is_empty());
    scorer.frame(0, RgbImage::new(8, 8));
    assert!(!scorer.is_empty());
}
