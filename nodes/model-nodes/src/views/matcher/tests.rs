#![allow(clippy::unwrap_used)]

use std::collections::BTreeSet;

use proptest::prelude::*;

use super::*;

const MS: i64 = 1_000_000;
/// An arbitrary time since the epoch \[ns\].
const START_NS: i64 = 1_700_000_000_000_000_000;
const RULES: Rules = Rules {
    tolerance_ns: 50 * MS,
    longest_wait_ns: 500 * MS,
    queue: 16,
};

/// A frame of a camera: when it was taken and when it arrives \[ms\].
#[derive(Clone, Copy, Debug)]
struct Frame {
    camera: usize,
    stamp: i64,
    arrives: i64,
}

/// Frames of a camera from `from` to `to` \[ms\], each `period` after the last, which arrive `lag` later.
fn stream(camera: usize, (from, to): (i64, i64), period: i64, lag: i64) -> Vec<Frame> {
    let stamps = (from..to).step_by(period as usize);
    let frame = |stamp| Frame {
        camera,
        stamp,
        arrives: stamp + lag,
    };
    stamps.map(frame).collect()
}

/// Everything that a matcher made of frames, by their order of arrival.
struct Outcome {
    /// Stamps of the frames of each match \[ms\], and the arrival that completed it.
    matches: Vec<(Vec<i64>, i64)>,
    drops: Vec<FrameDrop<i64>>,
}

impl Outcome {
    fn of(rules: Rules, cameras: usize, streams: &[Vec<Frame>]) -> Self {
        let mut frames = streams.concat();
        frames.sort_by_key(|frame| frame.arrives);
        let mut matcher = Matcher::new(rules, cameras);
        let (mut matches, mut drops) = (Vec::new(), Vec::new());
        for frame in frames {
            let stamp_ns = START_NS + frame.stamp * MS;
            let arrival = matcher.arrive(frame.camera, stamp_ns, frame.stamp);
            let found = arrival.matches.into_iter();
            matches.extend(found.map(|found| (found.frames, frame.arrives)));
            drops.extend(arrival.drops);
        }
        Self { matches, drops }
    }

    fn stamps(&self) -> Vec<Vec<i64>> {
        self.matches
            .iter()
            .map(|(stamps, _)| stamps.clone())
            .collect()
    }

    fn unmatched(&self) -> BTreeSet<usize> {
        let missing = self.drops.iter().filter_map(|drop| match drop.reason {
            DropReason::Unmatched { missing, .. } => Some(missing),
            _ => None,
        });
        missing.collect()
    }
}

#[test]
fn cameras_in_step_match_at_once() {
    let streams = [stream(0, (0, 1000), 200, 0), stream(1, (0, 1000), 200, 0)];
    let outcome = Outcome::of(RULES, 2, &streams);
    let expected: Vec<_> = (0..5).map(|index| vec![index * 200; 2]).collect();
    assert_eq!(outcome.stamps(), expected);
    let is_at_once = |(stamps, at): &(Vec<i64>, i64)| *at == stamps[0];
    assert!(outcome.matches.iter().all(is_at_once));
    assert!(outcome.drops.is_empty());
}

#[test]
fn leading_camera_adds_no_wait() {
    // A reference frame 20 ms after the other camera's: the next one would be 180 ms later.
    let streams = [stream(0, (20, 2020), 200, 5), stream(1, (0, 2000), 200, 5)];
    let outcome = Outcome::of(RULES, 2, &streams);
    assert_eq!(outcome.matches.len(), 10);
    for (index, (stamps, at)) in (0..).zip(&outcome.matches) {
        assert_eq!(*stamps, [index * 200 + 20, index * 200]);
        // Two frames show the rate.
        assert!(index < 2 || *at == stamps[0] + 5, "{stamps:?} at {at}");
    }
}

#[test]
fn constant_lag_up_to_the_longest_wait_loses_nothing() {
    for lag in [0, 30, 150, 400] {
        let streams = [
            stream(0, (0, 3000), 33, 0),
            stream(1, (10, 3010), 33, lag),
            stream(2, (-5, 2995), 33, 20),
        ];
        let outcome = Outcome::of(RULES, 3, &streams);
        let expected = (0..3000).step_by(33).map(|at| vec![at, at + 10, at - 5]);
        let expected: Vec<_> = expected.collect();
        // The last reference frame waits for a stamp of the third camera that would be nearer.
        let count = outcome.matches.len();
        assert!(count + 1 >= expected.len(), "{count} with lag {lag}");
        assert_eq!(outcome.stamps(), expected[..count]);
        assert_eq!(outcome.unmatched(), BTreeSet::new(), "{lag}");
    }
}

#[test]
fn slower_camera_sets_the_rate() {
    for (periods, offset) in [
        ((33, 100), 10),
        ((33, 100), -10),
        ((100, 33), 8),
        ((20, 200), 30),
    ] {
        let streams = [
            stream(0, (0, 4000), periods.0, 3),
            stream(1, (offset, 4000 + offset), periods.1, 3),
        ];
        let outcome = Outcome::of(RULES, 2, &streams);
        let slower = (4000 / periods.0.max(periods.1)) as usize;
        let count = outcome.matches.len();
        assert!(
            count + 2 >= slower && count <= slower,
            "{count} of {slower}"
        );
        assert_eq!(outcome.unmatched(), BTreeSet::new(), "{periods:?}");
        let surplus = outcome.drops.iter();
        assert!(
            surplus
                .clone()
                .all(|drop| drop.reason == DropReason::Surplus)
        );
        assert!(surplus.count() > slower);
    }
}

#[test]
fn frame_lost_by_another_camera_is_no_surplus() {
    // Within the wide tolerance are frames of other moments.
    let rules = Rules {
        tolerance_ns: 100 * MS,
        ..RULES
    };
    let mut lossy = stream(1, (4, 1004), 33, 0);
    lossy.remove(15);
    let outcome = Outcome::of(rules, 2, &[stream(0, (0, 1000), 33, 0), lossy]);
    let lost: Vec<_> = outcome
        .drops
        .iter()
        .map(|drop| (drop.camera, drop.frame))
        .collect();
    assert_eq!(lost, [(0, 15 * 33)]);
    assert_eq!(outcome.unmatched(), BTreeSet::from([1]));
}

#[test]
fn stamps_that_never_meet_are_no_surplus() {
    let streams = [stream(0, (0, 2000), 200, 0), stream(1, (100, 2100), 200, 0)];
    let outcome = Outcome::of(RULES, 2, &streams);
    assert!(outcome.matches.is_empty());
    assert_eq!(outcome.unmatched(), BTreeSet::from([1]));
}

#[test]
fn dead_camera_is_named_and_returns() {
    let of_dead = |camera| {
        let (first, last) = ((0, 1000), (3000, 4000));
        [stream(camera, first, 50, 0), stream(camera, last, 50, 0)].concat()
    };
    for dead in 0..3 {
        let streams: Vec<_> = (0..3)
            .map(|camera| match camera == dead {
                true => of_dead(camera),
                false => stream(camera, (0, 4000), 50, 0),
            })
            .collect();
        let outcome = Outcome::of(RULES, 3, &streams);
        let expected = (0..1000).chain(3000..4000).step_by(50);
        let expected: Vec<_> = expected.map(|at| vec![at; 3]).collect();
        assert_eq!(outcome.stamps(), expected, "{dead}");
        assert_eq!(outcome.unmatched(), BTreeSet::from([dead]));
    }
}

#[test]
fn time_that_begins_anew_is_matched_anew() {
    let early = |camera| stream(camera, (0, 1000), 100, 0);
    let mut frames: Vec<Frame> = [early(0), early(1)].concat();
    // The same stamps again, as a bag in a loop has them; the cameras jump one after the other.
    let again = frames.clone().into_iter().map(|frame| Frame {
        stamp: frame.stamp - 100_000,
        arrives: frame.stamp + 2000 + 30 * frame.camera as i64,
        ..frame
    });
    frames.extend(again.collect::<Vec<_>>());
    let outcome = Outcome::of(RULES, 2, &[frames]);
    let early = outcome.matches.iter().filter(|(stamps, _)| stamps[0] >= 0);
    assert_eq!(early.count(), 10);
    let late = outcome.matches.iter().filter(|(stamps, _)| stamps[0] < 0);
    assert!(late.count() >= 9, "{:?}", outcome.stamps());
}

#[test]
fn clock_of_another_time_is_reported_with_its_distance() {
    let streams = [stream(0, (0, 2000), 100, 0), {
        let ahead = stream(1, (0, 2000), 100, 0).into_iter();
        let ahead = ahead.map(|frame| Frame {
            stamp: frame.stamp + 3_600_000,
            ..frame
        });
        ahead.collect()
    }];
    let outcome = Outcome::of(RULES, 2, &streams);
    assert!(outcome.matches.is_empty());
    let nearest = outcome.drops.iter().find_map(|drop| match drop.reason {
        DropReason::Unmatched {
            missing: 1,
            nearest_ns,
        } => nearest_ns,
        _ => None,
    });
    assert!(
        (nearest.unwrap() / MS - 3_600_000).abs() <= 200,
        "{nearest:?}"
    );
}

fn stamps() -> impl Strategy<Value = i64> {
    prop_oneof![
        any::<i64>(),
        START_NS..START_NS + 3000 * MS,
        Just(i64::MIN),
        Just(i64::MAX)
    ]
}

proptest! {
    #[test]
    fn no_frame_is_used_twice_or_lost(
        cameras in 2usize..=4,
        queue in 1usize..6,
        tolerance_ns in prop_oneof![Just(0), 1..100 * MS, Just(i64::MAX)],
        frames in prop::collection::vec((0usize..4, stamps()), 0..200)
    ) {
        let rules = Rules { tolerance_ns, longest_wait_ns: 500 * MS, queue };
        let mut matcher = Matcher::new(rules, cameras);
        let mut seen = BTreeSet::new();
        let mut used = 0;
        for (index, (camera, stamp_ns)) in frames.iter().enumerate() {
            let camera = camera % cameras;
            let arrival = matcher.arrive(camera, *stamp_ns, (index, camera, *stamp_ns));
            for found in &arrival.matches {
                prop_assert_eq!(found.frames.len(), cameras);
                prop_assert_eq!(found.offsets_ns.len(), cameras);
                for (own, (index, camera, frame_ns)) in found.frames.iter().enumerate() {
                    prop_assert_eq!(own, *camera);
                    prop_assert!(seen.insert(*index));
                    prop_assert!(frame_ns.abs_diff(found.stamp_ns) <= tolerance_ns.unsigned_abs());
                }
                used += cameras;
            }
            for drop in &arrival.drops {
                prop_assert_eq!((drop.camera, drop.stamp_ns), (drop.frame.1, drop.frame.2));
                prop_assert!(seen.insert(drop.frame.0));
                used += 1;
            }
            prop_assert!(matcher.waiting() <= cameras * queue);
            prop_assert_eq!(used + matcher.waiting(), index + 1);
        }
    }

    /// The rule of training: the nearest frame of the other camera within half a period.
    #[test]
    fn partners_are_the_nearest_frames(
        period in 20i64..300,
        phase in -0.35f64..0.35,
        lag in 0i64..400,
        jitters in prop::collection::vec(-0.03f64..0.03, 60)
    ) {
        let jitters: Vec<i64> = jitters.iter().map(|share| (share * period as f64) as i64).collect();
        let phase = (phase * period as f64) as i64;
        let of = |camera: usize, offset: i64, lag: i64| -> Vec<Frame> {
            let jitters = jitters.iter().skip(camera).step_by(2);
            (0..).zip(jitters).map(|(index, jitter)| {
                let stamp = index * period + offset + jitter;
                Frame { camera, stamp, arrives: stamp + lag }
            }).collect()
        };
        let streams = [of(0, 0, 0), of(1, phase, lag)];
        let rules = Rules { tolerance_ns: period * MS / 2, longest_wait_ns: 1000 * MS, queue: 64 };
        let outcome = Outcome::of(rules, 2, &streams);
        let [references, others] = &streams;
        prop_assert!(outcome.matches.len() + 1 >= references.len(), "{} matches", outcome.matches.len());
        for (reference, found) in references.iter().zip(outcome.stamps()) {
            let nearest = others.iter().min_by_key(|other| other.stamp.abs_diff(reference.stamp));
            prop_assert_eq!(found, vec![reference.stamp, nearest.unwrap().stamp]);
        }
    }
}
