#![allow(clippy::unwrap_used)]

use super::*;
use crate::Level;
use image::{Rgb, RgbImage};

/// A box that moves by two pixels per step, with a little noise.
fn shown(step: u64, noise: u64) -> Signature {
    let x = (step * 2 % 48) as u32;
    Signature::of(&RgbImage::from_fn(64, 48, |column, row| {
        let is_inside = (x..x + 12).contains(&column) && (20..32).contains(&row);
        // 0 to 2 levels without a pattern.
        let mut jitter = u64::from(column) << 32 | u64::from(row) << 20 | noise;
        for shift in [31, 29, 33] {
            jitter = (jitter ^ (jitter >> shift)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        }
        let jitter = if noise == 0 { 0 } else { (jitter >> 40) % 3 };
        let level = if is_inside { 240 } else { 60 };
        Rgb([level + jitter as u8; 3])
    }))
}

/// Pictures at 10 Hz, each with a step of the motion and noise.
fn pictures(frames: impl IntoIterator<Item = (u64, u64)>) -> Pictures {
    let mut pictures = Pictures::new("/camera");
    for (index, (step, noise)) in frames.into_iter().enumerate() {
        let at_ns = index as i64 * 100_000_000;
        pictures.push(
            at_ns,
            step * 1000 + noise,
            Some((64, 48)),
            Some(shown(step, noise)),
        );
    }
    pictures
}

fn acting(_: i64, _: i64) -> Option<f32> {
    Some(1.0)
}

fn faults(pictures: &Pictures) -> Vec<(String, Level)> {
    let findings = pictures.check(Some(&acting));
    findings
        .iter()
        .map(|f| (f.check.to_string(), f.level))
        .collect()
}

#[test]
fn pictures_in_motion_have_no_finding() {
    assert_eq!(faults(&pictures((0..80).map(|k| (k, k)))), []);
    let summary = pictures((0..80).map(|k| (k, k))).summary();
    assert_eq!(summary.what, "/camera: 64x48, 80 pictures at 10.0 Hz");
}

#[test]
fn repeating_every_second_picture_halves_the_rate() {
    for noise in [0, 1] {
        // Byte for byte, and recoded with noise.
        let pictures = pictures((0..80).map(|k| (k / 2, (k + 1) * noise)));
        let findings = pictures.check(Some(&acting));
        assert_eq!(findings.len(), 1, "{findings:?}");
        assert_eq!(
            (&*findings[0].check, findings[0].level),
            ("repeats", Level::Warning)
        );
        let rate = findings[0].figures["true_rate_hz"];
        assert!((rate - 5.0).abs() < 0.3, "{findings:?}");
        assert!(findings[0].what.contains("10.0 Hz come"), "{findings:?}");
    }
}

#[test]
fn two_repeats_of_five_are_forty_percent() {
    let step = |k: u64| if k % 5 == 1 || k % 5 == 3 { k - 1 } else { k };
    let found = pictures((0..80).map(|k| (step(k), 0))).check(Some(&acting));
    let share = found[0].figures["repeated_share"];
    assert!((share - 0.4).abs() < 0.03, "{found:?}");
}

#[test]
fn three_repeats_of_a_slow_camera_are_found() {
    let found = pictures((0..120).map(|k| (k / 4, 0))).check(Some(&acting));
    let rate = found[0].figures["true_rate_hz"];
    assert!((rate - 2.5).abs() < 0.3, "{found:?}");
}

#[test]
fn repeats_are_found_by_bytes_alone() {
    let mut pictures = Pictures::new("/camera");
    for index in 0..60_u64 {
        pictures.push(index as i64 * 100_000_000, index / 2, None, None);
    }
    let found = pictures.check(None);
    assert_eq!(found.len(), 1, "{found:?}");
    assert!((found[0].figures["repeated_share"] - 0.5).abs() < 0.05);
}

/// A stopped driver publishes its last four buffers in turn.
#[test]
fn buffers_in_turn_are_repeats_or_a_freeze() {
    // For 2 of every 4 s.
    let in_turn = |k: u64| {
        if k % 40 < 20 {
            k
        } else {
            k / 40 * 40 + 16 + k % 4
        }
    };
    let found = pictures((0..160).map(|k| (in_turn(k), 0))).check(Some(&acting));
    let repeated: Vec<_> = found.iter().map(|f| &*f.check).collect();
    assert!(repeated.contains(&"frozen"), "{found:?}");
    // For 0.8 s of every 2 s: too short for a freeze, and pictures are not decoded.
    let in_turn = |k: u64| {
        if k % 20 < 12 {
            k
        } else {
            k / 20 * 20 + 8 + k % 4
        }
    };
    let mut bytes = Pictures::new("/camera");
    for index in 0..160 {
        bytes.push(index as i64 * 100_000_000, in_turn(index), None, None);
    }
    let found = bytes.check(None);
    assert_eq!(&*found[0].check, "repeats", "{found:?}");
    let share = found[0].figures["repeated_share"];
    assert!((share - 0.4).abs() < 0.05, "{found:?}");
    // The changes between successive pictures stay known.
    let mut turning = pictures((0..40).map(|k| (k, 0)));
    let change = turning.push(4_000_000_000, 36_000, None, Some(shown(36, 0)));
    assert!(change.unwrap() > 0.5, "{change:?}");
    // From the last motion to the end.
    let stopped = pictures((0..120).map(|k| (if k < 40 { k } else { 36 + k % 4 }, 0)));
    let found = stopped.check(Some(&acting));
    let frozen_s = found[0].figures["frozen_s"];
    assert!((frozen_s - 8.0).abs() < 0.3, "{found:?}");
}

#[test]
fn frozen_camera_is_an_error_with_noise_too() {
    for noise in [0, 1] {
        let frozen = pictures((0..60).map(|k| (7, (k + 1) * noise)));
        assert_eq!(
            faults(&frozen),
            [("frozen".to_owned(), Level::Error)],
            "{noise}"
        );
    }
}

#[test]
fn temporary_freeze_is_a_warning() {
    let part = pictures((0..120).map(|k| (if (40..80).contains(&k) { 40 } else { k }, k)));
    let found = part.check(Some(&acting));
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(
        (&*found[0].check, found[0].level),
        ("frozen", Level::Warning)
    );
    assert!(
        (found[0].figures["frozen_s"] - 4.0).abs() < 0.3,
        "{found:?}"
    );
}

#[test]
fn still_scene_of_an_idle_robot_is_no_fault() {
    let idle = |_: i64, _: i64| Some(0.0);
    for noise in [0, 1] {
        let still = pictures((0..60).map(|k| (7, k * noise)));
        assert_eq!(still.check(Some(&idle)), []);
    }
    // A simulator without noise: the arm rests for 0.5 s between two motions.
    let rests = pictures((0..80).map(|k| (k - k % 10 % 6, 0)));
    assert_eq!(rests.check(Some(&idle)), []);
}

#[test]
fn standstill_without_actions_gets_a_note() {
    let found = pictures((0..60).map(|_| (7, 0))).check(None);
    assert_eq!((&*found[0].check, found[0].level), ("frozen", Level::Note));
}

#[test]
fn changing_sizes_are_named() {
    let mut both = Pictures::new("/camera");
    for index in 0..40 {
        let size = if index < 25 { (64, 48) } else { (128, 72) };
        both.push(index * 100_000_000, index as u64, Some(size), None);
    }
    let found = both.check(Some(&acting));
    assert_eq!(found[0].check, "sizes");
    assert!(
        found[0].what.contains("25 of 64x48, 15 of 128x72"),
        "{found:?}"
    );
}

#[test]
fn missing_frames_are_counted() {
    let mut gappy = Pictures::new("/camera");
    let kept = (0..100).filter(|index| index % 10 != 5);
    for index in kept {
        gappy.push(
            index * 100_000_000,
            index as u64,
            None,
            Some(shown(index as u64, 1)),
        );
    }
    let found = gappy.check(Some(&acting));
    assert_eq!(
        (&*found[0].check, found[0].level),
        ("dropped", Level::Warning)
    );
    assert!(
        found[0].what.contains("10 of 100 frames are missing"),
        "{found:?}"
    );
}

#[test]
fn long_recording_is_examined_up_to_a_limit() {
    let mut long = Pictures::new("/camera");
    for index in 0..PICTURES_LIMIT as u64 + 10 {
        long.push(index as i64 * 33_000_000, index, None, None);
    }
    assert_eq!(long.count(), PICTURES_LIMIT as u64 + 10);
    let found = long.check(None);
    assert!(found[0].what.contains("9 more were not"), "{found:?}");
}

#[test]
fn appended_parts_are_examined_together() {
    let shown_twice = |from: u64| pictures((from..from + 20).map(|k| (k / 2, k)));
    let mut both = shown_twice(0);
    both.append(shown_twice(20));
    assert_eq!(both.count(), 40);
    let found = both.check(Some(&acting));
    assert_eq!(&*found[0].check, "repeats", "{found:?}");
    let mut none = Pictures::new("/camera");
    none.append(Pictures::new("/camera"));
    assert_eq!(none.count(), 0);
    none.append(shown_twice(0));
    assert_eq!(none.count(), 20);
}
