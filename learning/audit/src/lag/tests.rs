#![allow(clippy::unwrap_used)]

use super::*;
use crate::Level;
use wm_motion::actions::{ActionSpace, Dimension, Kind};

/// Smooth pseudo-random motion: the speed of frame `frame` of episode `episode`.
fn speed(episode: usize, frame: usize) -> f32 {
    let (e, t) = (episode as f32 * 1.7, frame as f32);
    ((0.9 * t + 1.3 * (0.37 * t + e).sin() + e).sin() * 0.03) * (1.2 + (0.11 * t + 2.0 * e).cos())
}

/// Episodes of Bridge V2's actions at 5 Hz; pictures and state lag by these frames.
fn episodes(count: usize, frames: usize, (pictures, state): (usize, usize)) -> Vec<Episode> {
    let of = |episode: usize| {
        let late = |frame: usize, lag: usize| match frame.checked_sub(lag) {
            Some(frame) => speed(episode, frame),
            None => 0.0,
        };
        let mut made = Episode::new("e", 7);
        let mut x = 0.3;
        for frame in 0..frames {
            let before = frame
                .checked_sub(1)
                .map_or(0.0, |frame| late(frame, pictures));
            let motion = 200.0 * before.abs() + 0.2;
            made.push(
                &[speed(episode, frame), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
                Some(motion),
                Some(&[x]),
            );
            x += late(frame, state);
        }
        made
    };
    (0..count).map(of).collect()
}

fn found(episodes: &[Episode], space: &ActionSpace) -> Finding {
    let found = check(Episodes {
        episodes,
        space,
        period_s: 1.0 / space.rate(),
    });
    assert_eq!(found.len(), 1, "{found:?}");
    found.into_iter().next().unwrap()
}

#[test]
fn synchronous_pictures_have_no_fault() {
    let fine = found(&episodes(5, 60, (0, 0)), &ActionSpace::bridge());
    assert_eq!(
        (fine.level, fine.figures["lag_frames"]),
        (Level::Ok, 0.0),
        "{fine:?}"
    );
}

#[test]
fn two_frames_of_lag_are_a_fault_with_the_remedy() {
    // All episodes, and one short recording of 40 frames.
    for (count, frames) in [(5, 60), (1, 40)] {
        let late = found(&episodes(count, frames, (2, 0)), &ActionSpace::bridge());
        assert_eq!(
            (late.level, late.figures["lag_frames"]),
            (Level::Warning, 2.0),
            "{late:?}"
        );
        assert!(
            late.fix.unwrap().contains("--shift-actions 2"),
            "{}",
            late.what
        );
    }
}

#[test]
fn one_frame_of_lag_gets_a_note() {
    let late = found(&episodes(5, 60, (1, 1)), &ActionSpace::bridge());
    assert_eq!(
        (late.level, late.figures["lag_frames"]),
        (Level::Note, 1.0),
        "{late:?}"
    );
}

#[test]
fn late_actions_are_shifted_earlier() {
    let mut late = episodes(5, 60, (0, 0));
    for episode in &mut late {
        // Each action comes three frames later.
        episode.actions_mut().rotate_right(3 * 7);
    }
    let found = found(&late, &ActionSpace::bridge());
    assert_eq!(
        (found.level, found.figures["lag_frames"]),
        (Level::Warning, -3.0),
        "{found:?}"
    );
    assert!(found.fix.unwrap().contains("--shift-actions -3"));
}

fn targets() -> ActionSpace {
    let joint = |name: &str| Dimension {
        name: name.into(),
        unit: "rad".into(),
        kind: Kind::JointPosition,
        offset: 0.0,
        scale: 1.0,
        clip: 1.0,
    };
    ActionSpace::new("joints".into(), 15.0, vec![joint("a")]).unwrap()
}

/// A joint that lags its targets by three frames, and pictures that lag by `late` more.
fn followers(late: usize) -> Vec<Episode> {
    let of = |episode: usize| {
        let mut made = Episode::new("e", 1);
        let path: Vec<f32> = (0..200)
            .scan(0.0, |sum, frame| {
                *sum += speed(episode, frame);
                Some(*sum)
            })
            .collect();
        let at = |frame: usize| path[frame.min(199)];
        for frame in 0..190 {
            let seen = |frame: usize| at(frame.saturating_sub(2 + late));
            let motion = 200.0 * (seen(frame) - seen(frame.saturating_sub(1))).abs() + 0.2;
            made.push(
                &[at(frame)],
                Some(motion),
                Some(&[at(frame.saturating_sub(2))]),
            );
        }
        made
    };
    (0..5).map(of).collect()
}

#[test]
fn arm_may_lag_behind_its_targets() {
    let follows = found(&followers(0), &targets());
    assert_eq!(follows.level, Level::Note, "{follows:?}");
    let late = found(&followers(4), &targets());
    assert_eq!(late.level, Level::Warning, "{late:?}");
    assert!(late.what.contains("lag the state by 4 frames"), "{late:?}");
}

#[test]
fn actions_of_another_recording_are_unrelated() {
    let mut other = episodes(10, 60, (0, 0));
    // A pseudo-random sequence.
    let mut state = 7_u64;
    for value in other.iter_mut().flat_map(Episode::actions_mut) {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        *value = (state >> 40) as f32 / 1e9;
    }
    let none = found(&other, &ActionSpace::bridge());
    assert_eq!(none.level, Level::Warning, "{none:?}");
    assert!(none.what.contains("explain no motion"), "{none:?}");
    // 100 frames are too few to exclude chance.
    let few = found(&other[..2], &ActionSpace::bridge());
    assert_eq!(few.level, Level::Ok, "{few:?}");
}

#[test]
fn zero_actions_with_motion_are_a_fault() {
    let mut zero = episodes(2, 60, (0, 0));
    for episode in &mut zero {
        episode.actions_mut().fill(0.0);
    }
    let found = found(&zero, &ActionSpace::bridge());
    assert_eq!(found.level, Level::Warning, "{found:?}");
    assert!(found.what.contains("zero in all 120 frames"), "{found:?}");
}

#[test]
fn too_few_frames_are_not_judged() {
    let few = found(&episodes(1, 20, (3, 0)), &ActionSpace::bridge());
    assert!(
        few.level == Level::Ok && few.what.contains("not judged"),
        "{few:?}"
    );
}
