//! The audit of the live camera and actions.

use crate::{Actions, Camera, Finding, Level, ModelFacts, Survey, camera};
use std::sync::Arc;
use wm_audit::{ActionTrack, Audit, Episode, Episodes};
use wm_motion::{
    actions::{ActionSpace, Dimension, Kind},
    motion::{Motion, MotionSettings, Pace},
};

/// Faults of the camera's pictures, and of pictures and actions together. The checks of camera and action cover stamps.
pub(crate) fn check(
    survey: &Survey,
    (camera, action): (Option<&str>, Option<&str>),
    model: Option<&ModelFacts>,
) -> Vec<Finding> {
    let mut findings = examine(survey, (camera, action), model);
    // Repeated and frozen pictures are also found by their bytes, without actions: report the worse finding only.
    let is_repeat = |finding: &Finding| matches!(&*finding.check, "repeats" | "frozen");
    let worst = findings.iter().filter(|finding| is_repeat(finding));
    let worst = worst.map(|finding| finding.level).max();
    if let Some(repeats) = camera::repeats(survey, camera)
        && worst < Some(repeats.level)
    {
        findings.retain(|finding| !is_repeat(finding));
        findings.push(repeats);
    }
    findings
}

fn examine(
    survey: &Survey,
    (camera, action): (Option<&str>, Option<&str>),
    model: Option<&ModelFacts>,
) -> Vec<Finding> {
    let Some((_, camera)) = survey.camera(camera) else {
        return Vec::new();
    };
    let actions = survey.actions(action).map(|(_, actions)| actions);
    let actions = actions.filter(|actions| !actions.is_chunk && !actions.rows.is_empty());
    let space = actions.and_then(|actions| {
        let space = model.and_then(|model| model.action_space.as_ref())?;
        let fits = actions
            .rows
            .iter()
            .all(|(_, values)| space.check(values).is_ok());
        fits.then_some(space)
    });
    let track = actions.map_or_else(ActionTrack::default, |actions| track(actions, space));
    let activity = |from_ns, to_ns| track.activity(from_ns, to_ns);
    let known: Option<wm_audit::Activity<'_>> = (!track.is_empty()).then_some(&activity);
    let mut findings = camera.comparison.pictures.check(known);
    // sequence numbers already show lost messages
    findings.retain(|finding| finding.check != "dropped");
    if let (Some(actions), Some(space)) = (actions, space) {
        let episode = episode(camera, actions, space);
        let together = Audit::of_episodes(Episodes {
            episodes: &[episode],
            space,
            period_s: 1.0 / space.rate(),
        });
        findings.extend(
            together
                .into_iter()
                .filter(|finding| finding.check == "lag"),
        );
    }
    let (skipped, compared) = (
        camera.comparison.skipped,
        camera.comparison.pictures.count(),
    );
    if skipped > 0 {
        let what = format!(
            "{skipped} of {} pictures arrived faster than they were decoded, and were not compared",
            skipped + compared
        );
        findings.push(Finding::note("frames", what));
    }
    findings.retain(|finding| finding.level > Level::Ok);
    findings
}

/// The activity of the robot. If the meaning of values is unknown, changes count as motion.
fn track(actions: &Actions, space: Option<&ActionSpace>) -> ActionTrack {
    let mut rows: Vec<(i64, &[f32])> = actions
        .rows
        .iter()
        .map(|(at_ns, values)| (*at_ns, values.as_slice()))
        .collect();
    rows.sort_by_key(|(at_ns, _)| *at_ns);
    let width = rows.first().map_or(0, |(_, values)| values.len());
    let targets = (0..width).map(|index| Dimension {
        name: format!("value_{index}"),
        unit: "1".to_owned(),
        kind: Kind::JointPosition,
        offset: 0.0,
        scale: 1.0,
        clip: 1.0,
    });
    let unknown = ActionSpace::new(
        "unknown".to_owned(),
        ActionSpace::BRIDGE_RATE,
        targets.collect(),
    );
    match space.or(unknown.as_ref().ok()) {
        Some(space) => ActionTrack::new(space, rows.into_iter()),
        None => ActionTrack::default(),
    }
}

/// The frames at the rate of the action space, with the actions between them.
fn episode(camera: &Camera, actions: &Actions, space: &ActionSpace) -> Episode {
    // a rate is at least 0.01 Hz
    let period_ns = (1e9 / space.rate()) as i64;
    let mut pace = Pace::new(period_ns, period_ns / 2);
    let mut motion = Motion::new(MotionSettings::of_period(period_ns));
    for (at_ns, values) in &actions.rows {
        motion.take(*at_ns, Arc::from(values.as_slice()));
    }
    let frames = camera.comparison.signatures.iter();
    let frames: Vec<_> = frames.filter(|(at_ns, _)| pace.is_due(*at_ns)).collect();
    let mut episode = Episode::new("live", space.len());
    let pairs = frames.iter().zip(frames.iter().skip(1));
    let mut change = None;
    for ((at_ns, here), (next_ns, next)) in pairs {
        let interval = motion.between(space, *at_ns, *next_ns);
        if let Some(interval) = interval.filter(|interval| interval.is_given) {
            episode.push(&interval.values, change, None);
        }
        change = here.change(next);
    }
    episode
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Picture, Stream, comparison::Comparison, fit::facts, survey::DEFAULT_ACTION,
        survey::DEFAULT_CAMERA, timeline::regular,
    };
    use image::{Rgb, RgbImage};
    use wm_audit::Pictures;
    use wm_camera::signature::Signature;

    const START: i64 = 1_800_000_000_000_000_000;

    /// Position of the arm at tick `tick` of 30 Hz \[m\].
    fn place(tick: i64) -> f32 {
        let t = tick as f32 / 6.0;
        0.05 * (0.9 * t + 1.3 * (0.37 * t).sin()).sin()
    }

    /// A camera of 30 Hz that shows tick `shown(k)` at tick `k`, and actions of 30 Hz.
    fn survey(shown: impl Fn(i64) -> i64, acts: bool) -> Survey {
        let mut comparison = Comparison {
            pictures: Pictures::new("/camera/image_raw"),
            ..Comparison::default()
        };
        let mut actions = Actions::default();
        for tick in 0..240 {
            let at_ns = START + tick * 33_333_333;
            let seen = shown(tick);
            let left = (100.0 + 1500.0 * place(seen)) as i64;
            let picture = RgbImage::from_fn(240, 96, |x, y| {
                let is_inside = (left..left + 40).contains(&i64::from(x)) && (30..70).contains(&y);
                Rgb([if is_inside { 240 } else { 60 }; 3])
            });
            let signature = Signature::of(&picture);
            comparison.signatures.push((at_ns, signature.clone()));
            comparison
                .pictures
                .push(at_ns, seen as u64, Some((64, 48)), Some(signature));
            let dx = if acts {
                place(tick + 1) - place(tick)
            } else {
                0.0
            };
            actions
                .rows
                .push((at_ns, vec![dx, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]));
        }
        let mut survey = Survey::default();
        let camera = Camera {
            comparison,
            pictures: vec![Ok(Picture::default())],
            ..Camera::default()
        };
        survey.cameras.insert(DEFAULT_CAMERA.into(), camera);
        survey.actions.insert(DEFAULT_ACTION.into(), actions);
        survey
    }

    fn found(survey: &Survey) -> Vec<Finding> {
        check(survey, (None, None), Some(&facts()))
    }

    #[test]
    fn good_camera_has_no_finding() {
        assert_eq!(found(&survey(|tick| tick, true)), []);
        // a resting arm in a simulation without noise
        assert_eq!(found(&survey(|_| 0, false)), []);
    }

    #[test]
    fn repeated_pictures_are_reported_with_the_true_rate() {
        let found = found(&survey(|tick| tick / 2 * 2, true));
        assert_eq!((found.len(), &*found[0].check), (1, "repeats"), "{found:?}");
        let figure = |name: &str| found[0].figures[name];
        assert!((figure("rate_hz") - 30.0).abs() < 0.01, "{found:?}");
        assert!((figure("true_rate_hz") - 15.0).abs() < 0.5, "{found:?}");
    }

    #[test]
    fn a_frozen_camera_is_an_error() {
        let found = found(&survey(|_| 5, true));
        assert_eq!(
            (&*found[0].check, found[0].level),
            ("frozen", Level::Error),
            "{found:?}"
        );
    }

    #[test]
    fn late_pictures_are_found_within_seconds() {
        let found = found(&survey(|tick| tick - 12, true));
        let lag = found.iter().find(|finding| finding.check == "lag");
        assert_eq!(
            lag.map(|lag| lag.figures["lag_frames"]),
            Some(2.0),
            "{found:?}"
        );
    }

    #[test]
    fn unknown_action_values_count_as_motion_if_they_change() {
        let mut survey = survey(|_| 5, true);
        let rows = survey.actions.get_mut(DEFAULT_ACTION).unwrap();
        // three joints that hold their targets
        for (_, values) in &mut rows.rows {
            *values = vec![0.4, -0.2, 1.1];
        }
        assert_eq!(found(&survey), []);
    }

    /// With messages on the topic; each picture arrives `times` times.
    fn with_messages(mut survey: Survey, times: u64) -> Survey {
        let mut stream = Stream {
            timeline: regular(240, 33, 10),
            ..Stream::default()
        };
        for arrival in &mut stream.timeline.0 {
            arrival.fingerprint = arrival.fingerprint.map(|picture| picture / times);
        }
        let camera = survey.cameras.get_mut(DEFAULT_CAMERA).unwrap();
        camera.raw = Some(stream);
        survey
    }

    #[test]
    fn picture_fault_is_reported_once() {
        let twice = found(&with_messages(survey(|tick| tick / 2 * 2, true), 2));
        assert_eq!((twice.len(), &*twice[0].check), (1, "repeats"), "{twice:?}");
        let stopped = found(&with_messages(survey(|_| 5, true), 1000));
        let frozen = stopped
            .iter()
            .filter(|finding| finding.level == Level::Error);
        assert_eq!(frozen.count(), 1, "{stopped:?}");
        // without motion, only the bytes show it
        let resting = found(&with_messages(survey(|_| 5, false), 2));
        assert_eq!(
            (resting.len(), &*resting[0].check),
            (1, "camera"),
            "{resting:?}"
        );
        let good = found(&with_messages(survey(|tick| tick, true), 1));
        assert_eq!(good, []);
    }
}
