use super::{
    super::{Cut, DataOptions, Episode},
    outcome::Outcome,
};
use crate::testing::{CAMERA, Recorder, START_NS};

fn recorded(write: impl FnOnce(&mut Recorder), options: DataOptions) -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::new(&bag);
    write(&mut recorder);
    recorder.finish();
    Outcome::of(&bag, options).unwrap()
}

#[test]
fn camera_gap_starts_an_episode() {
    let write = |recorder: &mut Recorder| {
        for frame in 0..20 {
            // One frame is missing at the tenth, and stamps jitter by 30 ms.
            let ms = frame * 200 + if frame >= 10 { 200 } else { 0 } + (frame % 2) * 30;
            recorder.frame(CAMERA, ms, frame as u8);
        }
        for tick in 0..220 {
            recorder.action(tick * 20, 0.001);
        }
    };
    let outcome = recorded(write, DataOptions::default());
    assert_eq!(outcome.lengths(), [10, 10]);
    assert_eq!(outcome.reds(), (0..20).collect::<Vec<u8>>());
    let names: Vec<_> = outcome.episodes().iter().map(|e| e.name.clone()).collect();
    assert_eq!(names, ["run#1", "run#2"]);
    // 0.001 m every 20 ms: over the jittery interval of 230 ms and, at the end of the first episode, over one period.
    let firsts = outcome.episodes()[0].actions.iter().map(|a| a[0]);
    let firsts: Vec<f32> = firsts.collect();
    assert!((firsts[0] - 0.0115).abs() < 1e-6, "{firsts:?}");
    assert!((firsts[9] - 0.01).abs() < 1e-6, "{firsts:?}");
    assert_eq!(
        outcome.manifest.episodes[1].begin_ns,
        START_NS + 2_200_000_000
    );

    let options = DataOptions {
        gap_periods: Some(2.5),
        ..DataOptions::default()
    };
    assert_eq!(recorded(write, options).lengths(), [20]);
}

/// For each of some bags, whether its pieces are on both sides of the split.
fn is_divided(write: impl Fn(&mut Recorder), options: DataOptions) -> Vec<bool> {
    let dir = tempfile::tempdir().unwrap();
    for number in 0..12 {
        let mut recorder = Recorder::new(&dir.path().join(format!("run_{number}")));
        recorder.frame(CAMERA, -200, number);
        recorder.action(-200, 0.01);
        write(&mut recorder);
        recorder.finish();
    }
    let options = DataOptions {
        validation: Some(0.5),
        ..options
    };
    let outcome = Outcome::of(dir.path(), options).unwrap();
    let validation = outcome.data.validation.as_ref().unwrap().episodes();
    let has = |episodes: &[Episode], bag: &str| {
        episodes.iter().any(|episode| episode.name.starts_with(bag))
    };
    let is_divided = |number| {
        let bag = format!("run_{number}#");
        let (training, validation) = (has(outcome.episodes(), &bag), has(validation, &bag));
        assert!(training || validation, "{bag} has several episodes");
        training && validation
    };
    (0..12).map(is_divided).collect()
}

#[test]
fn pieces_of_a_recording_are_on_one_side() {
    let frames = |recorder: &mut Recorder, missing: &dyn Fn(i64) -> bool| {
        for frame in 0..30 {
            if !missing(frame) {
                recorder.frame(CAMERA, frame * 200, frame as u8);
            }
        }
    };
    let actions = |recorder: &mut Recorder, from: i64, to: i64| {
        (from..to).for_each(|frame| recorder.action(frame * 200, 0.01));
    };
    let gaps = |recorder: &mut Recorder| {
        frames(recorder, &|frame| frame == 10 || frame == 20);
        actions(recorder, 0, 30);
    };
    assert_eq!(is_divided(gaps, DataOptions::default()), [false; 12]);
    let without_actions = |recorder: &mut Recorder| {
        frames(recorder, &|_| false);
        actions(recorder, 0, 10);
        actions(recorder, 20, 30);
    };
    let options = DataOptions::default();
    assert_eq!(is_divided(without_actions, options), [false; 12]);
    // Explicit cuts make episodes of their own.
    let whole = |recorder: &mut Recorder| {
        frames(recorder, &|_| false);
        actions(recorder, 0, 30);
    };
    let options = DataOptions {
        cut_seconds: Some(2.0),
        ..DataOptions::default()
    };
    assert!(is_divided(whole, options).contains(&true));
}

/// The clock passes 12 of 20 s twice; these are excluded. Setting it back without overlap starts an episode.
#[test]
fn clock_set_back_ends_an_episode() {
    let write = |recorder: &mut Recorder| {
        recorder.run(0..100);
        for frame in 100..200 {
            recorder.frame(CAMERA, frame * 200 - 12_000, frame as u8);
            recorder.action(frame * 200 - 12_000, 0.01);
        }
    };
    let outcome = recorded(write, DataOptions::default());
    assert_eq!(outcome.lengths(), [40, 40]);
    let expected: Vec<u8> = (0..40).chain(160..200).collect();
    assert_eq!(outcome.reds(), expected);
    let left_out = outcome.left_out();
    assert!(
        left_out.contains("240 messages") && left_out.contains("clock was set back"),
        "{left_out}"
    );

    let adjacent = |recorder: &mut Recorder| {
        recorder.run(60..90);
        for frame in 0..60 {
            recorder.frame(CAMERA, frame * 200, frame as u8);
            recorder.action(frame * 200, 0.01);
        }
    };
    assert_eq!(
        recorded(adjacent, DataOptions::default()).lengths(),
        [60, 30]
    );
}

#[test]
fn malformed_stamps_are_counted_by_topic() {
    let write = |recorder: &mut Recorder| {
        recorder.run(0..5);
        recorder.malformed(900);
        recorder.malformed(950);
        recorder.run(5..10);
    };
    let outcome = recorded(write, DataOptions::default());
    assert_eq!(outcome.lengths(), [10]);
    let left_out = outcome.left_out();
    for topic in ["/wm/action", "/joint_states"] {
        let of_topic =
            |line: &&str| line.contains(topic) && line.contains("expected less than 1e9 ns");
        let lines: Vec<&str> = left_out.lines().filter(of_topic).collect();
        assert!(
            matches!(lines[..], [line] if line.contains("2 messages")),
            "{left_out}"
        );
    }
}

#[test]
fn message_of_a_cut_topic_starts_an_episode() {
    let write = |recorder: &mut Recorder| {
        recorder.run(0..6);
        recorder.text("/episode", 1_100, "whatever");
        recorder.text("/episode", 1_110, "twice is once");
        recorder.run(6..10);
    };
    let options = DataOptions {
        cut_topic: vec!["/episode".into()],
        ..DataOptions::default()
    };
    let outcome = recorded(write, options.clone());
    assert_eq!(outcome.lengths(), [6, 4]);
    assert_eq!(recorded(write, DataOptions::default()).lengths(), [10]);

    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::new(&bag);
    recorder.run(0..4);
    recorder.finish();
    let error = Outcome::of(&bag, options).err().unwrap().to_string();
    assert!(
        error.contains("--cut-topic: no bag has /episode"),
        "{error}"
    );
}

#[test]
fn only_new_instructions_start_an_episode() {
    let write = |recorder: &mut Recorder| {
        recorder.run(0..1);
        // It arrives after the first frame, since discovery takes time.
        recorder.text("/task/instruction", 10, "open the drawer");
        recorder.run(1..5);
        recorder.text("/task/instruction", 900, "open the drawer");
        recorder.run(5..8);
        recorder.text("/task/instruction", 1_500, "close the drawer");
        recorder.run(8..12);
    };
    let options = DataOptions {
        cut: vec![Cut::Instruction],
        ..DataOptions::default()
    };
    let outcome = recorded(write, options);
    assert_eq!(outcome.lengths(), [8, 4]);
    let instructions: Vec<_> = outcome
        .episodes()
        .iter()
        .map(|e| e.instruction.clone().unwrap())
        .collect();
    assert_eq!(instructions, ["open the drawer", "close the drawer"]);
    let whole = recorded(write, DataOptions::default());
    assert_eq!(whole.lengths(), [12]);
}

#[test]
fn success_belongs_to_the_episode_that_it_ends() {
    let write = |recorder: &mut Recorder| {
        recorder.run(0..5);
        recorder.success(800, true);
        recorder.run(5..9);
        recorder.success(1_600, false);
        recorder.run(9..12);
    };
    let options = DataOptions {
        cut_topic: vec!["/task/success".into()],
        ..DataOptions::default()
    };
    let outcome = recorded(write, options);
    assert_eq!(outcome.lengths(), [5, 4, 3]);
    let successes: Vec<_> = outcome.episodes().iter().map(|e| e.success).collect();
    assert_eq!(successes, [Some(true), Some(false), None]);
    let statistics = outcome.data.training.statistics().unwrap();
    let success = statistics.success;
    assert_eq!(
        (success.succeeded, success.failed, success.unknown),
        (1, 1, 1)
    );
}

/// Seconds count from the first frame, at any camera rate.
#[test]
fn episodes_are_cut_by_time_and_short_ones_named() {
    for hertz in [5, 30] {
        let write = |recorder: &mut Recorder| {
            for tick in 0..11 * hertz / 5 {
                recorder.frame(CAMERA, tick * 1000 / hertz, 1);
                recorder.action(tick * 1000 / hertz, 0.05 / hertz as f32);
            }
        };
        let options = DataOptions {
            cut_seconds: Some(1.0),
            min_seconds: Some(0.8),
            ..DataOptions::default()
        };
        let outcome = recorded(write, options);
        assert_eq!(outcome.lengths(), [5, 5], "{hertz} Hz");
        for action in outcome.episodes().iter().flat_map(|e| &e.actions) {
            // Stamps are whole milliseconds.
            assert!((action[0] - 0.01).abs() < 1e-4, "{hertz} Hz: {action:?}");
        }
        let left = outcome.left_out();
        assert!(
            left.contains("an episode of 0.20 s; the minimum is 0.8 s"),
            "{hertz} Hz: {left}"
        );
    }
}

#[test]
fn frames_without_actions_are_excluded_and_counted() {
    let write = |recorder: &mut Recorder| {
        for frame in 0..20 {
            recorder.frame(CAMERA, frame * 200, frame as u8);
            // The robot starts later and stops earlier than the camera.
            if (5..15).contains(&frame) {
                recorder.action(frame * 200, 0.01);
            }
        }
    };
    let outcome = recorded(write, DataOptions::default());
    // The last action lasts until the fifteenth frame, the end.
    assert_eq!(outcome.reds(), (5..=15).collect::<Vec<u8>>());
    let left = outcome.left_out();
    assert!(
        left.contains("9 frames from") && left.contains("no message on /wm/action"),
        "{left}"
    );
}

/// One implausible message excludes only the frames around it.
#[test]
fn implausible_action_is_excluded_and_named() {
    // NaN; 3 m/s at 5 Hz; and a value at 10 Hz that is only plausible at 5 Hz.
    for (value, per_frame) in [(f32::NAN, 1), (0.6, 1), (0.4, 2)] {
        let write = |recorder: &mut Recorder| {
            for frame in 0..20 {
                recorder.frame(CAMERA, frame * 200, frame as u8);
                for part in 0..per_frame {
                    let is_bad = frame == 10 && part == 0;
                    let at_ms = frame * 200 + part * 200 / per_frame;
                    recorder.action(at_ms, if is_bad { value } else { 0.01 });
                }
            }
        };
        let outcome = recorded(write, DataOptions::default());
        let reds = outcome.reds();
        assert!(reds.len() >= 16 && !reds.contains(&10), "{value}: {reds:?}");
        assert_eq!(outcome.lengths().len(), 2);
        let left = outcome.left_out();
        assert!(left.contains("1 action: implausible"), "{value}: {left}");
    }
}

#[test]
fn frames_back_in_time_are_excluded() {
    let write = |recorder: &mut Recorder| {
        recorder.run(0..5);
        recorder.frame(CAMERA, 800, 99);
        recorder.picture_late(CAMERA, 100, 810, Vec::new());
        recorder.run(5..8);
    };
    let outcome = recorded(write, DataOptions::default());
    assert_eq!(outcome.reds(), (0..8).collect::<Vec<u8>>());
    let left = outcome.left_out();
    assert!(
        left.contains("2 pictures: the stamps on /camera") && left.contains("not later"),
        "{left}"
    );
}
