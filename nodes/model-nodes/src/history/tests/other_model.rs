//! A node that changes its model.

use super::*;

#[test]
fn history_continues_with_another_model_of_its_latents() {
    let mut before = history(2);
    for index in 0..4 {
        before.action(&action(index, 0.01), stamp(index)).unwrap();
        let frame = latent(stamp(index), "camera", index as f32);
        before.latent(&frame, reception()).unwrap();
    }
    let mut same = history(2);
    assert!(same.continue_from(&before, stamp(4)));
    assert!(same.epoch() > before.epoch());
    let (continued, moment) = (same.moment().unwrap(), before.moment().unwrap());
    assert_eq!(continued.observed.stamp_ns, moment.observed.stamp_ns);
    assert_eq!(same.future(2).unwrap(), before.future(2).unwrap());
    let frame = latent(stamp(4), "camera", 4.0);
    assert!(!same.latent(&frame, reception()).unwrap().flushed);

    let other_space = LatentSpace {
        hash: "def".into(),
        ..space()
    };
    let encoding = ActionEncoding::default();
    let mut other = History::new(before.settings, other_space, encoding, Time::default());
    assert!(!other.continue_from(&before, stamp(4)));
    assert!(other.epoch() > before.epoch() && other.newest().is_none());

    // The encoder sends the frames of the context again: the actions are still known.
    let again = |index: i64| {
        let mut frame = latent(stamp(index), "camera", index as f32);
        frame.space.hash = "def".into();
        frame.epoch = 9;
        frame
    };
    for index in 1..4 {
        let arrival = other.latent(&again(index), reception()).unwrap();
        assert_eq!((arrival.flushed, arrival.missed_frames), (false, 0));
    }
    assert_eq!(other.moment().unwrap().past, moment.past);
    assert_eq!(other.future(2).unwrap(), before.future(2).unwrap());
    let old = other.latent(&frame, reception()).unwrap_err();
    assert!(old.is_other_space(), "{old}");

    let settings = HistorySettings {
        timing: Timing::new(PERIOD, 3),
        ..before.settings
    };
    let encoding = ActionEncoding::default();
    let mut slower = History::new(settings, space(), encoding, Time::default());
    assert!(!slower.continue_from(&before, stamp(4)));
    assert_eq!(slower.timing(), settings.timing);
}
