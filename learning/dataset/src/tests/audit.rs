//! Audits of prepared data sets, and options that they recommend.

use image::{Rgb, RgbImage};
use wm_audit::Level;

use super::{
    super::{DataOptions, StampSource},
    outcome::Outcome,
};
use crate::testing::{CAMERA, MS, Recorder, START_NS, png};

/// A recording of 60 frames at 5 Hz with a fault.
struct Case {
    /// Stamp by recording time since the start.
    stamp_ns: fn(i64) -> i64,
    /// The time shown by picture `k`.
    shown: fn(i64) -> i64,
    size: fn(i64) -> (u32, u32),
}

const GOOD: Case = Case {
    stamp_ns: |ms| START_NS + ms * MS,
    shown: |k| k,
    size: |_| (64, 48),
};

/// Position of the arm at frame `k` \[m\].
fn place(k: i64) -> f32 {
    let t = k as f32;
    0.06 * (0.9 * t + 1.3 * (0.37 * t).sin()).sin()
}

fn record(case: &Case, recorder: &mut Recorder) {
    for k in 0..60 {
        let left = 24 + (300.0 * place((case.shown)(k).max(0))) as i64;
        let (width, height) = (case.size)(k);
        let picture = RgbImage::from_fn(width, height, |x, y| {
            let is_inside = (left..left + 16).contains(&i64::from(x)) && (16..32).contains(&y);
            Rgb(if is_inside { [250, 120, 20] } else { [60; 3] })
        });
        let ms = k * 200;
        recorder.picture_stamped(CAMERA, (case.stamp_ns)(ms), ms, png(picture.into()));
        recorder.action(ms, place(k + 1) - place(k));
    }
}

fn prepared(case: &Case, options: DataOptions) -> Result<Outcome, String> {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("run");
    let mut recorder = Recorder::new(&bag);
    record(case, &mut recorder);
    recorder.finish();
    Outcome::of(&bag, options).map_err(|error| error.to_string())
}

fn faults(case: &Case) -> Vec<(String, Level)> {
    let outcome = prepared(case, DataOptions::default()).unwrap();
    let faults = outcome.audit.faults();
    faults
        .map(|finding| (finding.check.to_string(), finding.level))
        .collect()
}

#[test]
fn good_recording_has_no_audit_faults() {
    assert_eq!(faults(&GOOD), []);
}

#[test]
fn audit_reports_faulty_pictures() {
    let frozen = Case {
        shown: |_| 3,
        ..GOOD
    };
    assert_eq!(faults(&frozen), [("frozen".to_owned(), Level::Error)]);
    let repeats = Case {
        shown: |k| k / 2 * 2,
        ..GOOD
    };
    assert_eq!(faults(&repeats)[0].0, "repeats");
}

#[test]
fn shifted_actions_cancel_a_lag() {
    let late = Case {
        shown: |k| k - 2,
        ..GOOD
    };
    let lag = |shift| {
        let options = DataOptions {
            shift_actions: Some(shift),
            ..DataOptions::default()
        };
        let outcome = prepared(&late, options).unwrap();
        let findings = outcome.audit.findings.iter();
        let mut lags = findings.filter(|finding| finding.check == "lag");
        let found = lags.next().unwrap();
        (found.level, found.figures["lag_frames"], outcome)
    };
    let (level, frames, _) = lag(0);
    assert_eq!((level, frames), (Level::Warning, 2.0));
    let (level, frames, outcome) = lag(2);
    assert_eq!((level, frames), (Level::Ok, 0.0));
    // No action is known for the first two frames.
    assert_eq!(outcome.lengths(), [58]);
    let firsts = outcome.episodes()[0].actions.iter().map(|action| action[0]);
    let expected = (0..58).map(|k| place(k + 1) - place(k));
    for (found, expected) in firsts.zip(expected) {
        assert!((found - expected).abs() < 1e-6, "{found} {expected}");
    }
}

#[test]
fn unusable_stamps_are_rejected_with_the_option() {
    let zero = Case {
        stamp_ns: |_| 0,
        ..GOOD
    };
    let constant = Case {
        stamp_ns: |_| START_NS,
        ..GOOD
    };
    for (case, named) in [
        (&zero, "every stamp is 0"),
        (&constant, "every stamp is the same"),
    ] {
        let error = prepared(case, DataOptions::default())
            .map(|_| ())
            .unwrap_err();
        assert!(
            error.contains(named) && error.contains("--stamps log"),
            "{error}"
        );
        for stamps in [StampSource::Log, StampSource::Publish] {
            let options = DataOptions {
                stamps: Some(stamps),
                ..DataOptions::default()
            };
            let outcome = prepared(case, options).unwrap();
            assert_eq!(outcome.lengths(), [60]);
            assert_eq!(outcome.audit.faults().count(), 0, "{}", outcome.audit);
        }
    }
}

#[test]
fn different_clocks_are_named_without_episodes() {
    let boot = Case {
        stamp_ns: |ms| (ms + 100_000) * MS,
        ..GOOD
    };
    let error = prepared(&boot, DataOptions::default())
        .map(|_| ())
        .unwrap_err();
    assert!(
        error.contains("of two clocks") && error.contains("--stamps log"),
        "{error}"
    );
}

#[test]
fn episode_ends_when_the_picture_size_changes() {
    let size = |k| if k < 25 { (64, 48) } else { (96, 48) };
    let outcome = prepared(&Case { size, ..GOOD }, DataOptions::default()).unwrap();
    assert_eq!(outcome.lengths(), [25, 35]);
    let sizes = outcome
        .audit
        .faults()
        .find(|finding| finding.check == "sizes")
        .unwrap();
    assert!(
        sizes.what.contains("35 of 96x48, 25 of 64x48"),
        "{}",
        sizes.what
    );

    let in_turn = Case {
        size: |k| if k % 2 == 0 { (64, 48) } else { (96, 48) },
        ..GOOD
    };
    let error = prepared(&in_turn, DataOptions::default())
        .map(|_| ())
        .unwrap_err();
    assert!(error.contains("changes 59 times"), "{error}");
}
