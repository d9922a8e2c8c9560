//! Bags with gaps and clock steps.

use std::path::Path;

use tempfile::TempDir;
use wm_bag::{BagWriter, WriterOptions};
use wm_import::lerobot::{ExportOptions, ExportReport, ImportOptions, export, import};
use wm_msgs::{
    builtin_interfaces::Time,
    sensor_msgs::Image,
    std_msgs::{Bool, Float32, Header},
    wm_msgs::Action,
};

use super::made::{START_NS, messages};

const MS: u64 = 1_000_000;

/// The messages at one time.
#[derive(Clone, Copy)]
struct Tick {
    number: u64,
    logged_ms: u64,
    stamp: Time,
    has_picture: bool,
    has_action: bool,
    has_gripper: bool,
}

/// A tick every 200 ms.
fn ticks(numbers: std::ops::Range<u64>) -> Vec<Tick> {
    let tick = |number| Tick {
        number,
        logged_ms: number * 200,
        stamp: Time::from_nanos((START_NS + number * 200 * MS) as i64),
        has_picture: true,
        has_action: true,
        has_gripper: true,
    };
    numbers.map(tick).collect()
}

impl Tick {
    /// Shifts all clocks.
    fn later(mut self, ms: i64) -> Self {
        self.logged_ms = self.logged_ms.strict_add_signed(ms);
        self.stamp = Time::from_nanos((START_NS + self.logged_ms * MS) as i64);
        self
    }
}

fn write(bag: &Path, ticks: &[Tick]) {
    let mut writer = BagWriter::create(bag, WriterOptions::default()).unwrap();
    for tick in ticks {
        let logged_ns = START_NS + tick.logged_ms * MS;
        let header = Header {
            stamp: tick.stamp,
            frame_id: String::new(),
        };
        if tick.has_picture {
            let image = Image {
                header: header.clone(),
                height: 16,
                width: 16,
                encoding: "bgr8".into(),
                step: 48,
                data: [0, 0, tick.number as u8].repeat(256),
                ..Image::default()
            };
            writer.write("/top/image_raw", &image, logged_ns).unwrap();
        }
        if tick.has_gripper {
            writer
                .write("/arm/gripper", &Float32 { data: 1.0 }, logged_ns)
                .unwrap();
        }
        if tick.has_action {
            let values = vec![tick.number as f32; 3];
            writer
                .write("/wm/action", &Action { header, values }, logged_ns)
                .unwrap();
        }
    }
    let last_ns = START_NS + ticks[ticks.len() - 1].logged_ms * MS;
    writer
        .write("/task/success", &Bool { data: true }, last_ns)
        .unwrap();
    writer.finish().unwrap();
}

/// Exports a bag of these ticks; also returns the numbers of the ticks whose actions are in each episode.
fn exported(ticks: &[Tick]) -> (ExportReport, Vec<Vec<u64>>) {
    let scratch = TempDir::new().unwrap();
    let bag = scratch.path().join("run");
    write(&bag, ticks);
    let dataset = scratch.path().join("dataset");
    let exported = export(&[bag], &dataset, &ExportOptions::default()).unwrap();
    let back = scratch.path().join("back");
    let bags = import(&dataset, &back, &ImportOptions::default())
        .unwrap()
        .bags;
    let actions = |bag: &_| -> Vec<Action> { messages(bag, "/wm/action") };
    let numbers = |actions: Vec<Action>| actions.iter().map(|a| a.values[0] as u64).collect();
    let episodes = bags.iter().map(|bag| numbers(actions(bag))).collect();
    let frames: usize = bags.iter().map(|bag| actions(bag).len()).sum();
    assert_eq!(exported.frames, frames as u64);
    (exported, episodes)
}

fn contains(lines: &[String], parts: &[&str]) -> bool {
    lines
        .iter()
        .any(|line| parts.iter().all(|part| line.contains(part)))
}

#[test]
fn gap_of_the_recording_begins_an_episode() {
    let mut all = ticks(0..10);
    all.extend(ticks(10..20).into_iter().map(|tick| tick.later(60_000)));
    let (found, episodes) = exported(&all);
    assert_eq!(episodes, [(0..10).collect::<Vec<_>>(), (10..20).collect()]);
    assert!(
        contains(&found.split, &["run: split into 2 recordings"]),
        "{found:?}"
    );
    assert_eq!((found.skipped, found.resampled), (vec![], vec![]));
}

#[test]
fn clock_step_back_begins_an_episode() {
    let mut all = ticks(36_000..36_010);
    let back = ticks(36_010..36_015);
    all.extend(back.into_iter().map(|tick| tick.later(-7_200_000)));
    let (found, episodes) = exported(&all);
    let expected = [36_010..36_015_u64, 36_000..36_010];
    assert_eq!(episodes, expected.map(Iterator::collect::<Vec<_>>));
    assert!(
        contains(&found.split, &["its clock is set back"]),
        "{found:?}"
    );
}

/// The clock passes 12 of 20 s twice: these are in no episode.
#[test]
fn times_passed_twice_are_skipped() {
    let mut all = ticks(0..100);
    all.extend(ticks(100..200).into_iter().map(|tick| tick.later(-12_000)));
    let (found, episodes) = exported(&all);
    // 100 is logged at the time of 40, and 139 at that of 79.
    assert_eq!(
        episodes,
        [(0..40).collect::<Vec<_>>(), (160..200).collect()]
    );
    let expected = [
        "/wm/action: 120 message(s) are skipped",
        "clock stepped back",
    ];
    assert!(contains(&found.resampled, &expected), "{found:?}");
}

#[test]
fn silent_camera_or_actions_begin_an_episode() {
    for silence in [
        |tick: &mut Tick| tick.has_picture = false,
        |tick: &mut Tick| tick.has_action = false,
    ] {
        let mut all = ticks(0..60);
        all[20..40].iter_mut().for_each(silence);
        let (found, episodes) = exported(&all);
        assert_eq!(episodes, [(0..20).collect::<Vec<_>>(), (40..60).collect()]);
        let topic = if all[20].has_action {
            "/top/image_raw"
        } else {
            "/wm/action"
        };
        let expected = [
            "split at 1 gap(s) of a topic, the longest of 4.200 s",
            topic,
        ];
        assert!(contains(&found.split, &expected), "{found:?}");
    }
    // A silent gripper does not.
    let mut all = ticks(0..60);
    all[20..40]
        .iter_mut()
        .for_each(|tick| tick.has_gripper = false);
    assert_eq!(exported(&all).1, [(0..60).collect::<Vec<_>>()]);
}

#[test]
fn part_without_a_topic_is_skipped_by_name() {
    let mut all = ticks(0..10);
    all.extend(ticks(10..20).into_iter().map(|tick| tick.later(60_000)));
    all[..10]
        .iter_mut()
        .for_each(|tick| tick.has_gripper = false);
    let (found, episodes) = exported(&all);
    assert_eq!(episodes, [(10..20).collect::<Vec<_>>()]);
    let expected = [
        "run: 10 action(s) and 10 picture(s)",
        "/arm/gripper: no message",
    ];
    assert!(contains(&found.skipped, &expected), "{found:?}");
}

/// Stamps step back or have too many nanoseconds, while the recorder's clock continues.
#[test]
fn messages_with_bad_stamps_are_counted_by_topic() {
    let mut all = ticks(0..20);
    for tick in &mut all[15..] {
        tick.stamp.sec -= 3600;
    }
    all[4].stamp.nanosec += 1_000_000_000;
    all[4].stamp.sec -= 1;
    let (found, episodes) = exported(&all);
    // The fifth frame repeats a neighbour's action.
    assert_eq!(episodes.len(), 1);
    assert_eq!(episodes[0].len(), 15);
    assert!(!episodes[0].contains(&4), "{episodes:?}");
    for topic in ["/wm/action", "/top/image_raw"] {
        for expected in [
            "5 message(s) are skipped: their stamps are not later",
            "1 message(s) are skipped: they cannot be decoded: ",
            "1923456789 ns: expected less than 1e9 ns",
        ] {
            assert!(contains(&found.resampled, &[topic, expected]), "{found:?}");
        }
    }
}
