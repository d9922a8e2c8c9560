#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

mod camera_clock;
mod jumps;
mod other_model;
mod slow_encoder;

use std::time::Instant;

use wm_motion::motion::StepAction;
use wm_msgs::{builtin_interfaces::Duration as Period, std_msgs::Header};
use wm_ros::PublisherId;
use wm_wire::latent_message::{LatentDtype, encode_latent};

use super::*;

const PERIOD: i64 = 200_000_000;
/// Bags begin at some date.
const START: i64 = 1_700_000_000_000_000_000;

fn space() -> LatentSpace {
    LatentSpace {
        name: "test".into(),
        hash: "abc".into(),
        height: 1,
        width: 1,
        channels: 2,
    }
}

fn history(context_frames: usize) -> History {
    let settings = HistorySettings {
        timing: Timing::new(PERIOD, 2),
        context_frames,
        merging: ChunkMerging::Latest,
    };
    History::new(
        settings,
        space(),
        ActionEncoding::default(),
        Time::default(),
    )
}

fn stamp(index: i64) -> Time {
    Time::from_nanos(START + index * PERIOD)
}

fn reception() -> Reception {
    Reception {
        stamp: Time::default(),
        clock_step_ns: 0,
        at: Instant::now(),
        publisher: PublisherId([1; 16]),
    }
}

fn latent(stamp: Time, frame_id: &str, value: f32) -> Latent {
    let header = Header {
        stamp,
        frame_id: frame_id.into(),
    };
    encode_latent(&[value; 2], &space(), LatentDtype::F32, header).unwrap()
}

fn action(index: i64, metres: f32) -> Action {
    Action {
        header: Header {
            stamp: stamp(index),
            frame_id: "base".into(),
        },
        values: vec![metres, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    }
}

fn chunk(index: i64, metres: &[f32]) -> ActionChunk {
    let actions = (index..)
        .zip(metres)
        .map(|(index, metres)| action(index, *metres));
    ActionChunk {
        header: action(index, 0.0).header,
        period: Period::from_nanos(PERIOD),
        actions: actions.collect(),
        ..ActionChunk::default()
    }
}

fn see_at(history: &mut History, stamp: Time) -> Result<Arrival, HistoryError> {
    let seconds = (stamp.to_nanos() - START) as f32 / PERIOD as f32;
    history.latent(&latent(stamp, "camera", seconds), reception())
}

fn see(history: &mut History, index: i64) -> Result<Arrival, HistoryError> {
    see_at(history, stamp(index))
}

fn act(history: &mut History, index: i64, metres: f32) -> Arrival {
    history
        .action(&action(index, metres), Time::default())
        .unwrap()
}

/// Translations along x of each interval of the steps.
fn metres(steps: &[StepAction]) -> Vec<f32> {
    let intervals = steps.iter().flat_map(|step| &step.intervals);
    intervals.map(|interval| interval.values[0]).collect()
}

#[test]
fn a_moment_is_frames_one_step_apart_with_what_was_done_between() {
    let mut history = history(3);
    for index in 0..6 {
        see(&mut history, index).unwrap();
        act(&mut history, index, index as f32 / 100.0);
    }
    let moment = history.moment().unwrap();
    let seen: Vec<f32> = moment.earlier.iter().map(|frame| frame.values[0]).collect();
    assert_eq!((seen, moment.observed.values[0]), (vec![1.0, 3.0], 5.0));
    assert_eq!(metres(&moment.past), [0.01, 0.02, 0.03, 0.04]);
    assert_eq!(&*moment.base_frame, "base");
    let context: Vec<f32> = moment.context().iter().map(|frame| frame[0]).collect();
    assert_eq!(context, [1.0, 3.0, 5.0]);
    assert_eq!(moment.past.len(), 2);
}

/// What was told at 30 Hz is the motion of the whole step, not a sample of it.
#[test]
fn a_motion_told_at_thirty_hertz_is_the_same_action() {
    let at = |rate: i64| {
        let mut history = history(2);
        for index in 0..3 {
            see(&mut history, index).unwrap();
        }
        for tick in 0..3 * rate {
            let mut told = action(0, 0.03 / rate as f32);
            told.header.stamp = Time::from_nanos(START + tick * PERIOD / rate);
            history.action(&told, Time::default()).unwrap();
        }
        (history.moment().unwrap().past, history.future(1).unwrap())
    };
    let (past, future) = at(1);
    for (found_past, found_future) in [at(2), at(6), at(10)] {
        let pairs = past
            .iter()
            .zip(&found_past)
            .chain(future.iter().zip(&found_future));
        for (expected, found) in pairs {
            for (expected, found) in expected.model.values.iter().zip(&found.model.values) {
                assert!((expected - found).abs() < 1e-5, "{expected} {found}");
            }
        }
    }
}

#[test]
fn jitter_within_the_tolerance_is_taken_and_beyond_is_a_gap() {
    let mut history = history(2);
    act(&mut history, -5, 0.0);
    see_at(&mut history, Time::from_nanos(START + 40_000_000)).unwrap();
    see(&mut history, 1).unwrap();
    see(&mut history, 2).unwrap();
    assert!(history.moment().is_ok());
    see_at(
        &mut history,
        Time::from_nanos(START + 3 * PERIOD + 60_000_000),
    )
    .unwrap();
    let missing_ns = START + PERIOD + 60_000_000;
    let wait = history.moment().unwrap_err();
    assert_eq!(wait, Wait::Gap { missing_ns });
    assert!(
        wait.to_string()
            .contains("1700000000.260000000 s is missing")
    );
}

#[test]
fn it_waits_for_frames_and_for_actions_by_name() {
    let mut history = history(2);
    assert_eq!(history.moment().unwrap_err(), Wait::NoFrame);
    see(&mut history, 0).unwrap();
    let short = Wait::Context { have: 1, need: 2 };
    assert_eq!(history.moment().unwrap_err(), short);
    see(&mut history, 1).unwrap();
    see(&mut history, 2).unwrap();
    let needed_ns = START;
    assert_eq!(history.moment().unwrap_err(), Wait::NoAction { needed_ns });
    act(&mut history, 0, 0.01);
    let held = history.moment().unwrap().past;
    assert_eq!(metres(&held), [0.01, 0.01]);
    assert!(!held[0].is_given());
}

#[test]
fn missed_frames_are_counted() {
    let mut history = history(2);
    assert_eq!(see(&mut history, 0).unwrap().missed_frames, 0);
    assert_eq!(see(&mut history, 1).unwrap().missed_frames, 0);
    assert_eq!(see(&mut history, 4).unwrap().missed_frames, 2);
}

#[test]
fn duplicates_and_late_frames_are_left_out() {
    let mut history = history(2);
    see(&mut history, 4).unwrap();
    let stamp_ns = START + 4 * PERIOD;
    assert_eq!(
        see(&mut history, 4),
        Err(HistoryError::Duplicate { stamp_ns })
    );
    let error = see(&mut history, 3).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("frame of 1700000000.600000000 s arrived after"),
        "{text}"
    );
    assert_eq!(error.reason(), "out_of_order");
}

#[test]
fn stamps_that_are_no_time_are_refused() {
    let mut history = history(1);
    for (sec, nanosec) in [(i32::MIN, 0), (-1, 0), (5, 4_000_000_000)] {
        let error = see_at(&mut history, Time { sec, nanosec }).unwrap_err();
        assert_eq!(error.reason(), "bad_stamp");
        assert!(
            error
                .to_string()
                .contains(&format!("{sec} s and {nanosec} ns")),
            "{error}"
        );
        let mut told = action(0, 0.0);
        told.header.stamp = Time { sec, nanosec };
        let error = history.action(&told, Time::default()).unwrap_err();
        assert_eq!(error.reason(), "bad_stamp");
    }
}

#[test]
fn what_is_stamped_ahead_of_the_clock_is_refused() {
    let mut history = history(1);
    let now = Reception {
        stamp: stamp(0),
        ..reception()
    };
    let hour = 18_000;
    let error = history
        .latent(&latent(stamp(hour), "camera", 0.0), now)
        .unwrap_err();
    assert!(error.to_string().contains("3600.00 s ahead"), "{error}");
    // 1.2 s.
    let error = history.latent(&latent(stamp(6), "camera", 0.0), now);
    let text = error.unwrap_err().to_string();
    assert!(text.contains("frame is stamped 1.20 s ahead"), "{text}");
    let text = history.action(&action(6, 0.0), now.stamp).unwrap_err();
    assert!(text.to_string().contains("action is stamped 1.20 s ahead"));
    let near = Time::from_nanos(START + 90_000_000);
    assert!(history.latent(&latent(near, "camera", 0.0), now).is_ok());
    // A policy announces what comes.
    assert!(history.chunk(&chunk(6, &[0.0]), now.stamp).is_ok());
    let latest = Time {
        sec: i32::MAX,
        nanosec: 0,
    };
    assert!(history.latent(&latent(latest, "camera", 0.0), now).is_err());
    assert!(history.action(&action(hour, 0.0), now.stamp).is_err());
    assert!(history.chunk(&chunk(hour, &[0.0]), now.stamp).is_err());
    // A clock that moves in steps is late by one.
    let mut simulated = self::history(1);
    let coarse = Reception {
        clock_step_ns: PERIOD,
        ..now
    };
    assert!(
        simulated
            .latent(&latent(stamp(1), "camera", 0.0), coarse)
            .is_ok()
    );
    assert!(
        simulated
            .latent(&latent(stamp(3), "camera", 0.0), coarse)
            .is_err()
    );
    // An hour back is a bag that is replayed.
    let mut history = self::history(1);
    assert!(
        history
            .latent(&latent(stamp(-hour), "camera", 0.0), now)
            .is_ok()
    );
}

#[test]
fn values_that_no_robot_moves_by_are_refused() {
    let mut history = history(1);
    let error = history
        .action(&action(0, 1e38), Time::default())
        .unwrap_err();
    assert_eq!(error.reason(), "malformed_action");
    let error = history
        .chunk(&chunk(0, &[0.0, -1e38]), Time::default())
        .unwrap_err();
    assert!(
        error.to_string().contains("action 1 of a chunk: dx"),
        "{error}"
    );
    let mut short = chunk(0, &[0.0]);
    short.period = Period::from_nanos(1);
    let error = history.chunk(&short, Time::default()).unwrap_err();
    assert!(error.to_string().contains("1 ns apart"), "{error}");
}

#[test]
fn a_second_camera_is_refused_and_named() {
    let mut history = history(1);
    act(&mut history, 0, 0.0);
    see(&mut history, 0).unwrap();
    let error = history
        .latent(&latent(stamp(1), "wrist", 9.0), reception())
        .unwrap_err();
    assert_eq!(error.reason(), "wrong_frame");
    let text = error.to_string();
    assert!(
        text.contains("\"wrist\"") && text.contains("\"camera\"") && text.contains("__ns"),
        "{text}"
    );
    let other = Reception {
        publisher: PublisherId([2; 16]),
        ..reception()
    };
    let error = history
        .latent(&latent(stamp(1), "camera", 9.0), other)
        .unwrap_err();
    assert!(
        error.to_string().contains("from another publisher"),
        "{error}"
    );
    see(&mut history, 1).unwrap();
    assert_eq!(history.moment().unwrap().observed.values[0], 1.0);
}

#[test]
fn frames_without_a_frame_id_are_of_the_same_camera() {
    let mut history = history(1);
    act(&mut history, 0, 0.0);
    for (index, frame_id) in ["", "camera", "", "camera"].into_iter().enumerate() {
        let latent = latent(stamp(index as i64), frame_id, index as f32);
        history.latent(&latent, reception()).unwrap();
    }
    let moment = history.moment().unwrap();
    assert_eq!(&*moment.observed.frame_id, "camera");
    history
        .latent(&latent(stamp(4), "", 4.0), reception())
        .unwrap();
    assert_eq!(&*history.moment().unwrap().observed.frame_id, "camera");
}

#[test]
fn another_camera_takes_over_from_one_that_is_silent() {
    let mut history = history(1);
    act(&mut history, 0, 0.0);
    see(&mut history, 0).unwrap();
    let epoch = history.epoch();
    let later = Reception {
        at: Instant::now() + Duration::from_secs(2),
        publisher: PublisherId([2; 16]),
        ..reception()
    };
    // An encoder that was started again.
    let arrival = history
        .latent(&latent(stamp(10), "camera", 9.0), later)
        .unwrap();
    assert!(arrival.flushed && history.epoch() > epoch);
    assert_eq!(history.moment().unwrap().observed.values[0], 9.0);
}

#[test]
fn latents_of_an_older_epoch_are_refused() {
    let mut history = history(1);
    act(&mut history, 0, 0.0);
    let of = |index, epoch| Latent {
        epoch,
        ..latent(stamp(index), "camera", index as f32)
    };
    history.latent(&of(0, 7), reception()).unwrap();
    let begun = history.epoch();
    assert!(history.latent(&of(1, 8), reception()).unwrap().flushed);
    assert!(history.epoch() > begun);
    let error = history.latent(&of(2, 7), reception()).unwrap_err();
    assert_eq!(
        (error.reason(), history.epoch() > begun),
        ("old_epoch", true)
    );
    assert_eq!(history.moment().unwrap().source_epoch, 8);
}

#[test]
fn epochs_are_greater_than_those_before_a_restart() {
    assert_eq!(epoch_after(0, Time::default()), 1);
    let now = Time { sec: 5, nanosec: 0 };
    assert_eq!(epoch_after(0, now), 5_000_000_000);
    assert_eq!(epoch_after(6_000_000_000, now), 6_000_000_001);
}

#[test]
fn the_last_action_goes_on_and_a_chunk_says_what_comes() {
    let mut history = history(1);
    act(&mut history, 0, 0.01);
    act(&mut history, 1, 0.02);
    see(&mut history, 1).unwrap();
    assert_eq!(metres(&history.future(2).unwrap()), [0.02; 4]);
    history
        .chunk(&chunk(1, &[0.03, 0.04, 0.05]), Time::default())
        .unwrap();
    let future = history.future(2).unwrap();
    // What was taken wins over what was announced, and the end of the chunk goes on.
    assert_eq!(metres(&future), [0.02, 0.04, 0.05, 0.05]);
    assert_eq!([future[0].is_given(), future[1].is_given()], [true, false]);
}

#[test]
fn a_chunk_that_answers_the_newest_frame_makes_a_step_due() {
    let mut history = history(1);
    see(&mut history, 0).unwrap();
    see(&mut history, 1).unwrap();
    let arrival = |history: &mut History, index| {
        history
            .chunk(&chunk(index, &[0.01; 8]), Time::default())
            .unwrap()
    };
    assert!(arrival(&mut history, 1).is_due);
    assert!(
        !arrival(&mut history, 2).is_due,
        "it answers a frame that is on its way"
    );
    see(&mut history, 2).unwrap();
    see(&mut history, 3).unwrap();
    assert!(
        arrival(&mut history, 2).is_due,
        "a policy that is one frame late"
    );
}

#[test]
fn frames_of_a_fast_camera_are_kept_and_thinned_by_time() {
    let mut history = history(2);
    act(&mut history, 0, 0.0);
    let frames = (0..60).map(|tick| {
        let stamp = Time::from_nanos(START + tick * PERIOD / 6);
        see_at(&mut history, stamp).unwrap()
    });
    let due: Vec<bool> = frames.map(|arrival| arrival.is_due).collect();
    let count = due.iter().filter(|is_due| **is_due).count();
    assert!((10..=11).contains(&count), "{count} of 60");
    assert!(history.moment().is_ok());
}

#[test]
fn a_slow_camera_is_named_with_what_to_set() {
    let mut history = history(2);
    act(&mut history, 0, 0.0);
    for second in 0..4 {
        let arrival = see(&mut history, second * 5).unwrap();
        assert!(!arrival.flushed && !arrival.held_back);
    }
    let text = history.moment().unwrap_err().to_string();
    assert!(
        text.contains("a frame every 1.00 s") && text.contains("frame_period:=1.00"),
        "{text}"
    );
    assert_eq!(
        see(&mut history, 20).unwrap().missed_frames,
        0,
        "said once, as what it is"
    );
}

#[test]
fn a_reset_forgets_everything() {
    let mut history = history(1);
    act(&mut history, 0, 0.01);
    see(&mut history, 0).unwrap();
    let epoch = history.epoch();
    history.reset(Time::default());
    assert!(history.epoch() > epoch);
    see(&mut history, 1).unwrap();
    assert!(matches!(history.moment().map(|_| ()), Ok(())));
    assert!(matches!(history.future(1), Err(Wait::NoAction { .. })));
}

#[test]
fn memory_is_bounded_by_the_span() {
    let mut history = history(2);
    history
        .chunk(&chunk(0, &vec![0.0; MAX_CHUNK]), Time::default())
        .unwrap();
    let long = chunk(0, &vec![0.0; MAX_CHUNK + 1]);
    assert!(history.chunk(&long, Time::default()).is_err());
    for index in 0..10_000 {
        act(&mut history, index, 0.0);
        see(&mut history, index).unwrap();
    }
    // A model step is two frames.
    assert!(history.frames.len() <= 5);
}

#[test]
fn a_chunk_of_another_clock_is_refused_and_hinders_none() {
    let mut history = history(1);
    see(&mut history, 0).unwrap();
    let far = history
        .chunk(&chunk(1_000_000, &[0.02]), Time::default())
        .unwrap_err();
    assert_eq!(far.reason(), "untimely_action");
    let text = far.to_string();
    assert!(
        text.contains("begins 200000 s after the newest frame"),
        "{text}"
    );
    let far = history
        .action(&action(1_000_000, 0.02), Time::default())
        .unwrap_err();
    assert_eq!(far.reason(), "untimely_action");
    history.chunk(&chunk(0, &[0.02]), Time::default()).unwrap();
    assert_eq!(metres(&history.future(1).unwrap())[0], 0.02);
}

#[test]
fn a_chunk_that_had_ended_when_it_came_is_named_once() {
    let mut history = history(2);
    see(&mut history, 4).unwrap();
    // Late: it ended with frame 2.
    history
        .chunk(&chunk(0, &[0.01; 2]), Time::default())
        .unwrap();
    let late = see(&mut history, 5).unwrap().late_chunk.unwrap();
    let text = late.to_string();
    assert!(
        text.contains("had ended 0.4 s before") && text.contains("stamp it with"),
        "{text}"
    );
    assert_eq!(see(&mut history, 6).unwrap().late_chunk, None, "once");
}

#[test]
fn a_frame_is_too_old_to_act_on_by_when_it_was_received() {
    let mut history = history(1);
    act(&mut history, 0, 0.0);
    see(&mut history, 0).unwrap();
    let moment = history.moment().unwrap();
    let age = Duration::from_secs(60);
    let later = moment.observed.reception.at + age;
    let limit = Duration::from_secs(2);
    assert_eq!(
        moment.expect_fresh(moment.observed.reception.at + limit, limit),
        Ok(())
    );
    let text = moment.expect_fresh(later, limit).unwrap_err().to_string();
    assert!(text.contains("arrived 60.0 s ago; at most 2.0 s"), "{text}");
}

#[test]
fn frame_period_of_zero_is_that_of_the_training() {
    let encoding = ActionEncoding::default();
    assert_eq!(Timing::of_camera(0.0, &encoding), Timing::new(PERIOD, 2));
    assert_eq!(
        Timing::of_camera(0.1, &encoding),
        Timing::new(100_000_000, 2)
    );
}
