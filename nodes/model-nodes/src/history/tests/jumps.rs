//! Time that jumps, and what only looks like it.

use super::*;

#[test]
fn one_odd_stamp_is_no_jump_of_time_and_is_counted() {
    for odd in [18_000, -18_000, 1_000_000] {
        let mut history = history(2);
        act(&mut history, 0, 0.01);
        for index in 0..3 {
            see(&mut history, index).unwrap();
        }
        let epoch = history.epoch();
        assert!(see(&mut history, odd).unwrap().held_back);
        let arrival = see(&mut history, 3).unwrap();
        assert_eq!((arrival.untimely, arrival.flushed), (1, false));
        assert_eq!((history.epoch(), history.moment().is_ok()), (epoch, true));
    }
}

#[test]
fn a_slow_camera_of_a_slow_model_is_no_jump() {
    let settings = HistorySettings {
        timing: Timing::new(2_000_000_000, 2),
        context_frames: 2,
        merging: ChunkMerging::Latest,
    };
    let mut history = History::new(
        settings,
        space(),
        ActionEncoding::default(),
        Time::default(),
    );
    act(&mut history, 0, 0.0);
    for index in 0..4 {
        let arrival = see(&mut history, index * 10).unwrap();
        assert!(!arrival.flushed && !arrival.held_back);
    }
    assert!(history.moment().is_ok());
}

#[test]
fn jump_back_starts_a_new_epoch_at_its_second_frame() {
    let mut history = history(2);
    for index in 0..30 {
        act(&mut history, index, 0.01);
        see(&mut history, index).unwrap();
    }
    history
        .chunk(&chunk(29, &[0.01; 8]), Time::default())
        .unwrap();
    let epoch = history.epoch();
    // A bag that loops: actions and chunks outrun frames, which pass through the encoder first.
    assert!(act(&mut history, 0, 0.02).held_back);
    let arrival = history
        .chunk(&chunk(0, &[0.02; 8]), Time::default())
        .unwrap();
    assert!(arrival.held_back);
    assert!(see(&mut history, 0).unwrap().held_back);
    assert!(act(&mut history, 1, 0.02).held_back);
    assert_eq!(history.epoch(), epoch);
    let arrival = see(&mut history, 1).unwrap();
    assert!(arrival.flushed && arrival.untimely == 0 && history.epoch() > epoch);
    act(&mut history, 2, 0.02);
    assert!(!see(&mut history, 2).unwrap().flushed);
    let moment = history.moment().unwrap();
    assert_eq!(
        metres(&moment.past),
        [0.02, 0.02],
        "nothing of the time before is left"
    );
    assert_eq!(metres(&history.future(3).unwrap()), [0.02; 6]);
}

#[test]
fn jump_ahead_starts_a_new_epoch_and_keeps_the_last_action() {
    let mut history = history(1);
    act(&mut history, 0, 0.01);
    see(&mut history, 0).unwrap();
    assert!(see(&mut history, 100).unwrap().held_back);
    assert!(see(&mut history, 101).unwrap().flushed);
    act(&mut history, 101, 0.03);
    assert_eq!(metres(&history.future(1).unwrap()), [0.03, 0.03]);
}

#[test]
fn a_clock_that_jumps_back_begins_a_new_epoch() {
    let mut history = history(2);
    for index in 0..30 {
        act(&mut history, index, 0.01);
        see(&mut history, index).unwrap();
    }
    let epoch = history.epoch();
    assert!(!history.clock_jumped(stamp(29)));
    assert!(history.clock_jumped(stamp(0)));
    assert!(history.epoch() > epoch);
    assert_eq!(history.moment().unwrap_err(), Wait::NoFrame);
    assert!(!see(&mut history, 0).unwrap().held_back);
}

#[test]
fn a_policy_that_is_slower_than_a_jump_is_heard() {
    let mut history = history(1);
    see(&mut history, 10).unwrap();
    // Two seconds old, of which one is still to come.
    let arrival = history
        .chunk(&chunk(0, &[0.01; 15]), Time::default())
        .unwrap();
    assert!(!arrival.held_back);
    assert_eq!(metres(&history.future(1).unwrap()), [0.01, 0.01]);
}
