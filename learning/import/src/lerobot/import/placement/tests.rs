#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use proptest::prelude::*;

use super::*;

const FPS: f64 = 30.0;

fn shown(count: usize, fps: f64) -> Vec<f64> {
    (0..count).map(|frame| frame as f64 / fps).collect()
}

/// Consecutive episodes of these lengths, with offsets of their starts \[frames\].
fn members(lengths: &[usize], off: impl Fn(usize) -> f64) -> Vec<Member> {
    let mut begin = 0;
    let member = |(index, length): (usize, &usize)| {
        begin += length;
        Member {
            index: index as i64,
            length: *length,
            from_s: ((begin - length) as f64 + off(index)) / FPS,
        }
    };
    lengths.iter().enumerate().map(member).collect()
}

fn ranges(placement: &Placement) -> Vec<Option<Range<usize>>> {
    placement
        .values()
        .map(|result| result.as_ref().ok().map(|frames| frames.range.clone()))
        .collect()
}

fn placed(times: &[f64], members: &[Member]) -> Vec<Option<Range<usize>>> {
    ranges(&place(&Times(times), FPS, members))
}

proptest! {
    /// Times that drift by up to two frames, and videos at another rate, give the correct frames.
    #[test]
    fn episodes_are_found_by_lengths_despite_drift(
        lengths in prop::collection::vec(7usize..30, 1..40),
        drift in 0.0f64..2.0,
        video_fps in prop_oneof![Just(30.0), Just(30_000.0 / 1001.0), Just(29.0)],
    ) {
        let total: usize = lengths.iter().sum();
        let count = lengths.len() as f64;
        let members = members(&lengths, |index| drift * index as f64 / count);
        let mut begin = 0;
        for (found, length) in placed(&shown(total, video_fps), &members).into_iter().zip(&lengths) {
            prop_assert_eq!(found, Some(begin..begin + length));
            begin += length;
        }
    }

    /// With a missing or surplus frame and no gap in time, all places are uncertain.
    #[test]
    fn wrong_number_of_frames_places_no_episode(
        lengths in prop::collection::vec(7usize..30, 2..20),
        surplus in any::<bool>(),
    ) {
        let total: usize = lengths.iter().sum();
        let total = if surplus { total + 1 } else { total - 1 };
        let found = placed(&shown(total, FPS), &members(&lengths, |_| 0.0));
        prop_assert!(found.iter().all(Option::is_none), "{:?}", found);
    }

    /// If times show the gap, only its episode is rejected.
    #[test]
    fn gap_in_time_rejects_its_episode(
        lengths in prop::collection::vec(7usize..30, 2..20),
        missing in 0.0f64..1.0,
    ) {
        let total: usize = lengths.iter().sum();
        // Not the first or last frame, whose absence times cannot show.
        let missing = 1 + (missing * (total - 2) as f64) as usize;
        let mut times = shown(total, FPS);
        times.remove(missing);
        let placement = place(&Times(&times), FPS, &members(&lengths, |_| 0.0));
        let mut begin = 0;
        for (result, length) in placement.values().zip(&lengths) {
            let has_gap = (begin..begin + length).contains(&missing);
            let first = begin - usize::from(begin > missing);
            match result {
                Ok(frames) => {
                    prop_assert!(!has_gap);
                    prop_assert_eq!(&frames.range, &(first..first + length));
                }
                Err(reason) => prop_assert!(has_gap && reason.contains("is missing"), "{reason}"),
            }
            begin += length;
        }
    }
}

#[test]
fn wrong_time_rejects_only_its_episode() {
    // The fourth starts past the end; the third starts where the second does.
    for (which, off) in [(3, 31_000.0), (2, -12.0)] {
        let members = members(&[12; 6], |index| if index == which { off } else { 0.0 });
        let placement = place(&Times(&shown(72, FPS)), FPS, &members);
        for (index, result) in &placement {
            assert_eq!(
                result.is_err(),
                *index == which as i64,
                "{index}: {result:?}"
            );
        }
        let reason = placement[&(which as i64)].as_ref().unwrap_err();
        assert!(
            reason.contains(&format!("episode {which} begins at")),
            "{reason}"
        );
    }
}

#[test]
fn two_episodes_at_one_place_are_rejected() {
    // The video has the frames of one of them.
    let mut members = members(&[12; 4], |_| 0.0);
    members.push(Member {
        index: 4,
        ..members[2]
    });
    let found = placed(&shown(48, FPS), &members);
    let is_found: Vec<bool> = found.iter().map(Option::is_some).collect();
    assert_eq!(is_found, [true, true, false, true, false]);
}

#[test]
fn removed_episodes_leave_gaps_and_order_may_differ() {
    let mut members = members(&[12, 20, 12, 12], |_| 0.0);
    members.remove(1);
    assert_eq!(
        placed(&shown(56, FPS), &members),
        [Some(0..12), Some(32..44), Some(44..56)]
    );
    // As in merged data sets, the second comes before the first.
    let member = |index, length, begin: usize| Member {
        index,
        length,
        from_s: begin as f64 / FPS,
    };
    let swapped = [member(0, 10, 15), member(1, 15, 0), member(2, 8, 25)];
    assert_eq!(
        placed(&shown(33, FPS), &swapped),
        [Some(15..25), Some(0..15), Some(25..33)]
    );
}

#[test]
fn video_of_one_episode_needs_a_frame_per_row() {
    let members = members(&[300], |_| 0.0);
    let of = |frames| {
        place(&Times(&shown(frames, FPS)), FPS, &members)
            .remove(&0)
            .unwrap()
    };
    assert_eq!(
        of(300),
        Ok(Frames {
            range: 0..300,
            note: None
        })
    );
    assert_eq!(of(304).unwrap().note, Some(SURPLUS));
    let reason = of(299).unwrap_err();
    assert!(
        reason.contains("expected 300 frames, one for each row of episode 0, got 299"),
        "{reason}"
    );
    assert!(place(&Times(&[]), FPS, &members)[&0].is_err());
}

#[test]
fn excessive_lengths_are_rejected() {
    let member = |index| Member {
        index,
        length: usize::MAX / 2,
        from_s: index as f64,
    };
    for times in [shown(100, FPS), vec![0.0, 0.1, 0.3, 0.4]] {
        let found = placed(&times, &[member(0), member(1), member(2)]);
        assert_eq!(found, [None, None, None]);
    }
}

#[test]
fn thousands_of_episodes_at_one_place_are_rejected() {
    let member = |index| Member {
        index,
        length: 10,
        from_s: 0.0,
    };
    let members: Vec<Member> = (0..20_000).map(member).collect();
    let found = placed(&shown(10, FPS), &members);
    assert!(found.iter().all(Option::is_none));
}
