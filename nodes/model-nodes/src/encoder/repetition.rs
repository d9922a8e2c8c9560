//! Frames that show the same picture again, byte for byte.

use wm_camera::recent_pictures::RecentPictures;

use super::{repeats::JUMP_NS, stillness::Rates};

/// A gap this long between two frames is a pause: the rates of before and after differ \[ns\].
const PAUSE_NS: i64 = 10_000_000_000;

/// A frame compared with the last ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Repeat {
    /// Whether one of the last frames had the same picture.
    pub is_repeated: bool,
    /// Since the last new picture \[ns\].
    pub since_new_ns: i64,
    /// Frames per second \[Hz\]; `None`: not known yet.
    pub rate: Option<f64>,
    /// New pictures per second \[Hz\]; `None`: not known yet.
    pub distinct_rate: Option<f64>,
    /// Whether the camera takes pictures at a steady rate, but is published faster.
    pub is_steady: bool,
}

impl Repeat {
    /// Whether the frame is a copy that the model does not need: a new picture comes soon.
    pub fn is_surplus(&self) -> bool {
        self.is_repeated && self.is_steady
    }
}

/// The last pictures of a camera.
#[derive(Clone, Debug, Default)]
pub(crate) struct Repetition {
    recent: RecentPictures,
    newest_ns: Option<i64>,
    new_ns: i64,
    rates: Rates,
}

impl Repetition {
    /// Takes a frame of the stamp `stamp_ns` whose picture has this fingerprint.
    pub fn frame(&mut self, stamp_ns: i64, fingerprint: u64) -> Repeat {
        let gap_ns = self
            .newest_ns
            .map_or(0, |newest_ns| stamp_ns.saturating_sub(newest_ns));
        if gap_ns < -JUMP_NS {
            self.restart();
        } else if gap_ns > PAUSE_NS {
            // The pictures stay: after a pause, a driver may publish its old buffers.
            self.rates = Rates::default();
        }
        // A frame that was overtaken counts as of the newest stamp.
        let stamp_ns = self
            .newest_ns
            .map_or(stamp_ns, |newest_ns| newest_ns.max(stamp_ns));
        self.newest_ns = Some(stamp_ns);
        let is_repeated = !self.recent.insert(fingerprint);
        if !is_repeated {
            self.new_ns = stamp_ns;
        }
        self.rates.push(stamp_ns, !is_repeated);
        Repeat {
            is_repeated,
            since_new_ns: stamp_ns.saturating_sub(self.new_ns),
            rate: self.rates.rate(),
            distinct_rate: self.rates.distinct_rate(),
            is_steady: self.rates.is_repeating(),
        }
    }

    /// Starts anew with the next frame, which is of another time or another camera.
    pub fn restart(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: i64 = 1_000_000_000 / 30;

    #[test]
    fn of_pictures_that_come_twice_the_second_is_surplus() {
        let mut repetition = Repetition::default();
        let mut surplus = 0;
        for index in 0..120 {
            let repeat = repetition.frame(index * PERIOD, index as u64 / 2);
            assert_eq!(repeat.is_repeated, index % 2 == 1);
            assert_eq!(repeat.since_new_ns, (index % 2) * PERIOD);
            surplus += i64::from(repeat.is_surplus());
        }
        assert!((50..=60).contains(&surplus), "{surplus}");
    }

    #[test]
    fn old_pictures_in_turn_are_repeated() {
        let mut repetition = Repetition::default();
        for index in 0..60 {
            repetition.frame(index * PERIOD, index as u64);
        }
        // The driver has stopped, and publishes its four buffers again and again.
        let mut last = None;
        for index in 60..120 {
            last = Some(repetition.frame(index * PERIOD, 56 + index as u64 % 4));
        }
        let repeat = last.unwrap();
        assert!(repeat.is_repeated && !repeat.is_surplus(), "{repeat:?}");
        assert_eq!(repeat.since_new_ns, 60 * PERIOD);
    }

    #[test]
    fn old_pictures_after_a_pause_are_repeated() {
        let mut repetition = Repetition::default();
        for index in 0..60 {
            repetition.frame(index * PERIOD, index as u64);
        }
        let begin_ns = 59 * PERIOD + 60_000_000_000;
        for index in 0..8 {
            let repeat = repetition.frame(begin_ns + index * PERIOD, 56 + index as u64 % 4);
            assert!(repeat.is_repeated, "{index}: {repeat:?}");
            assert_eq!(repeat.since_new_ns, 60_000_000_000 + index * PERIOD);
        }
        // The rates are those since the pause.
        let repeat = repetition.frame(begin_ns + 8 * PERIOD, 60);
        assert_eq!((repeat.is_repeated, repeat.since_new_ns), (false, 0));
        assert!(repeat.rate.is_none_or(|rate| rate > 20.0), "{repeat:?}");
    }

    #[test]
    fn a_step_back_begins_anew() {
        let mut repetition = Repetition::default();
        repetition.frame(60_000_000_000, 7);
        assert!(repetition.frame(61_000_000_000, 7).is_repeated);
        assert!(!repetition.frame(5_000_000_000, 7).is_repeated);
    }
}
