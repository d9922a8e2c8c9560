#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use wm_msgs::{builtin_interfaces::Duration, std_msgs::Header};

use super::*;

const PERIOD: i64 = 200_000_000;
/// Bags begin at some date.
const START: i64 = 1_700_000_000_000_000_000;

fn timeline(context_frames: usize) -> Timeline {
    Timeline::new(Timing::new(PERIOD, 2), context_frames)
}

fn stamp(index: i64) -> Time {
    Time::from_nanos(START + index * PERIOD)
}

fn action(index: i64, value: f32) -> Action {
    Action {
        header: Header {
            stamp: stamp(index),
            frame_id: "base".into(),
        },
        values: vec![value; 7],
    }
}

fn chunk(index: i64, values: &[f32]) -> ActionChunk {
    let actions = values
        .iter()
        .enumerate()
        .map(|(i, value)| action(index + i as i64, *value))
        .collect();
    ActionChunk {
        header: Header {
            stamp: stamp(index),
            frame_id: "base".into(),
        },
        period: Duration::from_nanos(PERIOD),
        actions,
        ..ActionChunk::default()
    }
}

fn see(timeline: &mut Timeline, index: i64) -> Result<Arrival, TimelineError> {
    timeline.frame(stamp(index), "camera", vec![index as f32].into())
}

fn firsts(actions: &[PhysicalAction]) -> Vec<f32> {
    actions.iter().map(|action| action.values[0]).collect()
}

#[test]
fn a_context_is_frames_one_step_apart_with_the_actions_between() {
    let mut timeline = timeline(3);
    for index in 0..6 {
        see(&mut timeline, index).unwrap();
        timeline.action(&action(index, index as f32)).unwrap();
    }
    let context = timeline.context().unwrap();
    let seen: Vec<f32> = context.frames.iter().map(|frame| frame.values[0]).collect();
    assert_eq!(seen, [1.0, 3.0, 5.0]);
    assert_eq!(
        context
            .actions
            .iter()
            .map(|step| firsts(step))
            .collect::<Vec<_>>(),
        [[1.0, 2.0], [3.0, 4.0]]
    );
}

#[test]
fn jitter_within_the_tolerance_is_taken_and_beyond_is_a_gap() {
    let mut timeline = timeline(2);
    timeline.action(&action(-5, 0.0)).unwrap();
    timeline
        .frame(Time::from_nanos(START + 40_000_000), "", vec![0.0].into())
        .unwrap();
    timeline.frame(stamp(2), "", vec![2.0].into()).unwrap();
    assert_eq!(timeline.context().unwrap().frames[0].values[0], 0.0);

    timeline
        .frame(
            Time::from_nanos(START + 3 * PERIOD + 60_000_000),
            "",
            vec![3.0].into(),
        )
        .unwrap();
    let missing_ns = START + PERIOD + 60_000_000;
    assert_eq!(timeline.context().unwrap_err(), Wait::Gap { missing_ns });
    assert!(
        Wait::Gap { missing_ns }
            .to_string()
            .contains("1700000000.260000000 s is missing")
    );
}

#[test]
fn it_waits_for_frames_and_for_actions_by_name() {
    let mut timeline = timeline(2);
    assert_eq!(timeline.context().unwrap_err(), Wait::NoFrame);
    see(&mut timeline, 0).unwrap();
    assert_eq!(
        timeline.context().unwrap_err(),
        Wait::Context { have: 1, need: 2 }
    );
    see(&mut timeline, 1).unwrap();
    see(&mut timeline, 2).unwrap();
    assert_eq!(
        timeline.context().unwrap_err(),
        Wait::NoAction { needed_ns: START }
    );
    timeline.action(&action(0, 1.0)).unwrap();
    assert_eq!(firsts(&timeline.context().unwrap().actions[0]), [1.0, 1.0]);
}

#[test]
fn missed_frames_are_counted() {
    let mut timeline = timeline(2);
    assert_eq!(see(&mut timeline, 0).unwrap().missed_frames, 0);
    assert_eq!(see(&mut timeline, 1).unwrap().missed_frames, 0);
    assert_eq!(see(&mut timeline, 4).unwrap().missed_frames, 2);
}

#[test]
fn duplicates_and_late_frames_are_left_out() {
    let mut timeline = timeline(2);
    see(&mut timeline, 4).unwrap();
    assert_eq!(
        see(&mut timeline, 4),
        Err(TimelineError::Duplicate {
            stamp_ns: START + 4 * PERIOD
        })
    );
    let error = see(&mut timeline, 3).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("frame of 1700000000.600000000 s came after"),
        "{error}"
    );
    assert_eq!(timeline.epoch(), 0);
}

#[test]
fn the_last_action_is_held_and_a_chunk_overrides_the_hold() {
    let mut timeline = timeline(1);
    timeline.action(&action(0, 1.0)).unwrap();
    timeline.action(&action(1, 2.0)).unwrap();
    let step = |timeline: &Timeline, index: i64| {
        firsts(&timeline.actions_of_step(START + index * PERIOD).unwrap())
    };
    assert_eq!(step(&timeline, 0), [1.0, 2.0]);
    assert_eq!(step(&timeline, 6), [2.0, 2.0]);

    timeline.chunk(&chunk(1, &[7.0, 8.0, 9.0])).unwrap();
    assert_eq!(
        step(&timeline, 1),
        [2.0, 8.0],
        "what was taken wins over what was announced"
    );
    assert_eq!(step(&timeline, 2), [8.0, 9.0]);
    assert_eq!(
        step(&timeline, 3),
        [9.0, 9.0],
        "the end of the chunk is held"
    );

    timeline.action(&action(4, 5.0)).unwrap();
    assert_eq!(
        step(&timeline, 4),
        [5.0, 5.0],
        "a later action ends the hold"
    );
}

#[test]
fn chunks_that_say_nothing_are_refused_and_the_old_one_stays() {
    let mut timeline = timeline(1);
    timeline.chunk(&chunk(0, &[1.0])).unwrap();
    let mut still = chunk(1, &[2.0]);
    still.period = Duration::default();
    assert_eq!(
        timeline.chunk(&still),
        Err(TimelineError::Chunk {
            count: 1,
            period_ns: 0
        })
    );
    assert!(matches!(
        timeline.chunk(&chunk(1, &[])),
        Err(TimelineError::Chunk { count: 0, .. })
    ));
    let error = timeline.chunk(&chunk(1, &[0.0, f32::NAN])).unwrap_err();
    assert!(
        error.to_string().contains("action 1 of a chunk: value 0"),
        "{error}"
    );
    assert!(matches!(
        timeline.chunk(&chunk(-1, &[3.0])),
        Err(TimelineError::OutOfOrder { .. })
    ));
    assert_eq!(
        firsts(&timeline.actions_of_step(START).unwrap()),
        [1.0, 1.0]
    );
    let short = Action {
        values: vec![0.0; 6],
        ..action(0, 0.0)
    };
    assert!(
        timeline
            .action(&short)
            .unwrap_err()
            .to_string()
            .contains("6 values where 7")
    );
}

#[test]
fn time_jumping_ahead_flushes_frames_and_holds_the_last_action() {
    let mut timeline = timeline(2);
    for index in 0..3 {
        timeline.action(&action(index, 1.0)).unwrap();
        see(&mut timeline, index).unwrap();
    }
    let arrival = see(&mut timeline, 100).unwrap();
    assert_eq!((arrival.flushed, arrival.missed_frames), (true, 0));
    assert_eq!(timeline.epoch(), 1);
    for index in 101..103 {
        see(&mut timeline, index).unwrap();
    }
    assert_eq!(timeline.context().unwrap().frames.len(), 2);
}

#[test]
fn a_clock_that_jumps_back_leaves_what_has_come_by_the_new_time() {
    let mut timeline = timeline(2);
    for index in 0..30 {
        timeline.action(&action(index, 1.0)).unwrap();
        see(&mut timeline, index).unwrap();
    }
    assert!(timeline.clock_jumped(Time::from_nanos(START)));
    assert_eq!(timeline.context().unwrap_err(), Wait::NoFrame);
    timeline.action(&action(0, 2.0)).unwrap();
    see(&mut timeline, 0).unwrap();
    assert!(!timeline.clock_jumped(Time::from_nanos(START)), "again");
    assert!(timeline.newest().is_some());
}

#[test]
fn time_jumping_back_flushes_whichever_stream_sees_it_first() {
    for action_first in [true, false] {
        let mut timeline = timeline(2);
        for index in 0..30 {
            timeline.action(&action(index, 1.0)).unwrap();
            see(&mut timeline, index).unwrap();
        }
        timeline.chunk(&chunk(29, &[1.0; 8])).unwrap();
        if action_first {
            assert!(timeline.action(&action(0, 2.0)).unwrap().flushed);
            assert_eq!(timeline.context().unwrap_err(), Wait::NoFrame);
            assert!(!see(&mut timeline, 0).unwrap().flushed);
        } else {
            assert!(see(&mut timeline, 0).unwrap().flushed);
            assert!(!timeline.action(&action(0, 2.0)).unwrap().flushed);
        }
        assert_eq!(timeline.epoch(), 1);
        assert_eq!(
            timeline.context().unwrap_err(),
            Wait::Context { have: 1, need: 2 }
        );
        for index in 1..3 {
            timeline.action(&action(index, 2.0)).unwrap();
            see(&mut timeline, index).unwrap();
        }
        let context = timeline.context().unwrap();
        assert_eq!(
            firsts(&context.actions[0]),
            [2.0, 2.0],
            "nothing of the time before is left"
        );
        assert_eq!(
            firsts(&timeline.actions_of_step(START + 2 * PERIOD).unwrap()),
            [2.0, 2.0]
        );
    }
}

#[test]
fn memory_is_bounded_by_the_span() {
    let mut timeline = timeline(2);
    timeline.chunk(&chunk(0, &vec![0.0; MAX_CHUNK])).unwrap();
    assert!(
        timeline
            .chunk(&chunk(0, &vec![0.0; MAX_CHUNK + 1]))
            .is_err()
    );
    for index in 0..10_000 {
        timeline.action(&action(index, 0.0)).unwrap();
        see(&mut timeline, index).unwrap();
    }
    // A model step is two frames, and jumps are told apart up to a second back.
    assert!(timeline.frames.len() <= 5 && timeline.actions.len() <= 11);
}

/// What each rule makes of one moment that two chunks speak of; elsewhere the newer one stays as it is.
#[test]
fn overlapping_chunks_are_merged_by_the_rule() {
    for (name, expected) in [
        ("latest", [10.0, 10.0, 10.0, 10.0]),
        ("weighted", [7.6, 7.9, 10.0, 10.0]),
        ("average", [6.0, 6.5, 10.0, 10.0]),
    ] {
        let mut timeline = timeline(1).with_chunk_merging(ChunkMerging::parse(name).unwrap());
        timeline.chunk(&chunk(0, &[0.0, 1.0, 2.0, 3.0])).unwrap();
        timeline.chunk(&chunk(2, &[10.0; 4])).unwrap();
        let merged: Vec<f32> = [2, 4]
            .iter()
            .flat_map(|index| firsts(&timeline.actions_of_step(START + index * PERIOD).unwrap()))
            .collect();
        for (merged, expected) in merged.iter().zip(expected) {
            assert!(
                (merged - expected).abs() < 1e-5,
                "{name}: {merged} for {expected}"
            );
        }
    }
    assert_eq!(ChunkMerging::parse("mean"), None);
}

#[test]
fn a_chunk_of_another_clock_is_refused_and_hinders_none() {
    let mut timeline = timeline(1);
    see(&mut timeline, 0).unwrap();
    let far = timeline.chunk(&chunk(1_000_000, &[2.0])).unwrap_err();
    assert_eq!(far.reason(), "untimely_action");
    let text = far.to_string();
    assert!(
        text.contains("begins 200000 s after the newest frame"),
        "{text}"
    );
    timeline.chunk(&chunk(0, &[2.0])).unwrap();
    assert!(timeline.is_given(START));
}

#[test]
fn only_what_was_said_is_given() {
    let mut timeline = timeline(1);
    timeline.action(&action(0, 1.0)).unwrap();
    timeline.chunk(&chunk(2, &[2.0, 2.0])).unwrap();
    let given: Vec<bool> = (-1..6)
        .map(|index| timeline.is_given(START + index * PERIOD))
        .collect();
    assert_eq!(given, [false, true, false, true, true, false, false]);
}

mod merging {
    use super::*;
    use proptest::prelude::*;

    fn rule() -> impl Strategy<Value = (ChunkMerging, f32)> {
        prop_oneof![
            Just((ChunkMerging::Latest, 1.0)),
            Just((ChunkMerging::Weighted, 0.7)),
            Just((ChunkMerging::Average, 0.5)),
        ]
    }

    proptest! {
        /// For any two chunks, however they lie and jitter: at every moment of the newer one its action is the weighted
        /// mean where the older one speaks too, and its own elsewhere.
        #[test]
        fn a_merged_chunk_is_the_weighted_mean_where_both_speak(
            (rule, weight) in rule(),
            older in prop::collection::vec(-1_f32..1.0, 1..12),
            newer in prop::collection::vec(-1_f32..1.0, 1..12),
            shift in 0_i64..14,
            jitter in -PERIOD / 5..PERIOD / 5,
        ) {
            let mut timeline = timeline(1).with_chunk_merging(rule);
            timeline.chunk(&chunk(1, &older)).unwrap();
            let mut second = chunk(1 + shift, &newer);
            let stamp_ns = second.header.stamp.to_nanos() + jitter;
            second.header.stamp = Time::from_nanos(stamp_ns);
            // One that is older than the first is refused, whatever the rule.
            prop_assume!(shift > 0 || jitter >= 0);
            timeline.chunk(&second).unwrap();
            for (index, new) in newer.iter().enumerate() {
                let slot_ns = stamp_ns + index as i64 * PERIOD;
                let got = timeline.actions.at(slot_ns, 0).unwrap().values;
                let expected = match older.get(shift as usize + index) {
                    Some(old) => (1.0 - weight) * old + weight * new,
                    None => *new,
                };
                for value in got {
                    prop_assert!((value - expected).abs() < 1e-5, "{value} for {expected} at {index}");
                }
            }
        }
    }
}

#[test]
fn a_chunk_that_had_ended_when_it_came_is_named_once() {
    let mut timeline = timeline(2);
    see(&mut timeline, 10).unwrap();
    // of another clock, or late: it ended with frame 8
    timeline.chunk(&chunk(0, &[0.1; 8])).unwrap();
    let late = see(&mut timeline, 11).unwrap().late_chunk.unwrap();
    assert_eq!(late.stamp_ns, stamp(0).to_nanos());
    let text = late.to_string();
    assert!(
        text.contains("had ended 0.4 s before") && text.contains("stamp it with"),
        "{text}"
    );
    assert_eq!(see(&mut timeline, 12).unwrap().late_chunk, None, "once");
    timeline.chunk(&chunk(11, &[0.1; 8])).unwrap();
    assert_eq!(see(&mut timeline, 13).unwrap().late_chunk, None);
}

#[test]
fn a_chunk_of_a_time_that_begins_anew_is_not_late() {
    let mut timeline = timeline(2);
    see(&mut timeline, 100).unwrap();
    // a bag that loops: its chunk comes before its frame
    timeline.chunk(&chunk(0, &[0.1; 8])).unwrap();
    let arrival = see(&mut timeline, 0).unwrap();
    assert!(arrival.flushed && arrival.late_chunk.is_none());
}
