//! Latents of an encoder that is slower than the camera.

use super::*;

/// A slow encoder sends a context once in a while, late.
#[test]
fn distant_frames_are_no_jump_if_as_much_time_has_passed() {
    let mut history = history(2);
    let epoch = history.epoch();
    let begin = Instant::now();
    let mut acted = 0;
    for context in 0..4_i64 {
        for frame in [40 * context, 40 * context + 2] {
            let now = frame + 30;
            while acted <= now {
                act(&mut history, acted, 0.01);
                acted += 1;
            }
            let reception = Reception {
                stamp: stamp(now),
                at: begin + Duration::from_nanos(PERIOD as u64) * u32::try_from(now).unwrap(),
                ..reception()
            };
            let arrival = history
                .latent(&latent(stamp(frame), "camera", frame as f32), reception)
                .unwrap();
            assert!(!arrival.held_back && !arrival.flushed);
            assert_eq!((arrival.untimely, arrival.missed_frames), (0, 0));
        }
        // Its actions are six seconds old.
        let moment = history.moment().unwrap();
        assert_eq!(metres(&moment.past), [0.01, 0.01]);
        assert!(!history.is_between_contexts());
    }
    assert_eq!(history.epoch(), epoch);

    // Until the next context is whole, the one before counts.
    let reception = Reception {
        stamp: stamp(190),
        at: begin + Duration::from_nanos(PERIOD as u64) * 190,
        ..reception()
    };
    let first = latent(stamp(160), "camera", 160.0);
    assert!(!history.latent(&first, reception).unwrap().flushed);
    assert!(history.moment().is_err() && history.is_between_contexts());
    assert_eq!(history.latest_moment().unwrap().observed.values[0], 122.0);
    let future = history.future_from(stamp(122).to_nanos(), 1).unwrap();
    assert_eq!(metres(&future), [0.01, 0.01]);
}

#[test]
fn frames_skipped_regularly_are_not_missing() {
    let settings = HistorySettings {
        timing: Timing::new(PERIOD, 1),
        context_frames: 2,
        merging: ChunkMerging::Latest,
    };
    let mut history = History::new(
        settings,
        space(),
        ActionEncoding::default(),
        Time::default(),
    );
    let frames = (0..10).flat_map(|context| [5 * context, 5 * context + 1]);
    let missed: Vec<u64> = frames
        .map(|frame| see(&mut history, frame).unwrap().missed_frames)
        .collect();
    // Twice may be a loss.
    assert_eq!(missed[..6], [0, 0, 3, 0, 3, 0]);
    assert!(missed[6..].iter().all(|missed| *missed == 0), "{missed:?}");
}
