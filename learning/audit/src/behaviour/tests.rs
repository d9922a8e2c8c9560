#![allow(clippy::unwrap_used)]

use super::*;
use crate::Level;
use wm_motion::actions::ActionSpace;

/// Episodes whose frame `frame` moves by `moves(frame)` along x and a little along the others.
fn episodes(moves: impl Fn(usize) -> f32) -> Vec<Episode> {
    let of = |_| {
        let mut made = Episode::new("e", 7);
        for frame in 0..60 {
            let x = moves(frame);
            let before = frame.checked_sub(1).map_or(0.0, &moves);
            let motion = if before == 0.0 { 0.1 } else { 4.0 };
            made.push(
                &[x, x / 2.0, x / 3.0, 0.0, 0.0, 0.0, 1.0],
                Some(motion),
                None,
            );
        }
        made
    };
    (0..4).map(of).collect()
}

fn wave(frame: usize) -> f32 {
    0.01 + 0.01 * (frame as f32).sin().abs()
}

fn faults(episodes: &[Episode]) -> Vec<(String, Level)> {
    let all = Episodes {
        episodes,
        space: &ActionSpace::bridge(),
        period_s: 0.2,
    };
    let findings = check(all)
        .into_iter()
        .filter(|finding| finding.level > Level::Ok);
    findings
        .map(|finding| (finding.check.to_string(), finding.level))
        .collect()
}

#[test]
fn moving_robot_has_no_fault() {
    assert_eq!(faults(&episodes(wave)), []);
}

#[test]
fn idle_starts_ends_and_episodes_are_found() {
    let start = episodes(|frame| if frame < 20 { 0.0 } else { wave(frame) });
    assert_eq!(faults(&start), [("idle".to_owned(), Level::Warning)]);
    let whole = episodes(|frame| if frame % 3 == 2 { wave(frame) } else { 0.0 });
    assert_eq!(faults(&whole), [("idle".to_owned(), Level::Warning)]);
    let end = faults(&episodes(
        |frame| if frame > 40 { 0.0 } else { wave(frame) },
    ));
    assert!(
        end.contains(&("idle".to_owned(), Level::Warning)),
        "{end:?}"
    );
    // 1.5 s of 12 s.
    let short = episodes(|frame| if frame < 7 { 0.0 } else { wave(frame) });
    assert_eq!(faults(&short), [("idle".to_owned(), Level::Note)]);
}

#[test]
fn zero_last_action_gets_a_note() {
    let zero = episodes(|frame| if frame == 59 { 0.0 } else { wave(frame) });
    assert_eq!(faults(&zero), [("last".to_owned(), Level::Note)]);
}

#[test]
fn value_far_beyond_the_others_is_an_outlier() {
    let jump = episodes(|frame| if frame == 30 { 0.39 } else { wave(frame) });
    let found = faults(&jump);
    assert!(
        found.contains(&("outliers".to_owned(), Level::Warning)),
        "{found:?}"
    );
    // Strong motion is not an outlier.
    assert_eq!(
        faults(&episodes(|frame| if frame == 30 {
            0.08
        } else {
            wave(frame)
        })),
        []
    );
}

#[test]
fn implausible_motion_is_another_unit() {
    let found = faults(&episodes(|frame| 30.0 * wave(frame)));
    assert_eq!(found, [("units".to_owned(), Level::Warning)]);
}

#[test]
fn gripper_of_another_range_is_a_fault_with_its_range() {
    let with = |range: [f32; 3]| {
        let mut made = Episode::new("e", 7);
        for frame in 0..60 {
            let x = wave(frame);
            let gripper = range[frame / 20];
            made.push(
                &[x, x / 2.0, x / 3.0, 0.0, 0.0, 0.0, gripper],
                Some(4.0),
                None,
            );
        }
        let all = Episodes {
            episodes: &[made],
            space: &ActionSpace::bridge(),
            period_s: 0.2,
        };
        let mut found = check(all);
        found.retain(|finding| finding.check == "gripper");
        found
    };
    assert_eq!(with([1.0, 0.0, 1.0]), []);
    let [range] = &with([1.0, 0.0, -1.0])[..] else {
        panic!("one finding")
    };
    assert_eq!(range.level, Level::Warning);
    assert!(
        range.what.contains("gripper: measured -1 to 1; expected 0"),
        "{}",
        range.what
    );
    let fix = range.fix.as_deref().unwrap();
    assert!(fix.contains("offset -1 and scale 0.5"), "{fix}");
    assert_eq!(with([0.0, 1.0, 1.0])[0].level, Level::Note);
}
