//! Frames that arrive by two transports, or twice.

use std::collections::VecDeque;

use wm_msgs::builtin_interfaces::Time;

/// Number of frames that are kept: the two transports of one frame are never further apart.
const REMEMBERED: usize = 16;
/// A stamp this far behind means that time jumped back, and earlier frames may come again. Nearer ones were overtaken, as
/// raw frames are by compressed ones \[ns\].
pub(crate) const JUMP_NS: i64 = 1_000_000_000;

/// Finds a frame's second arrival by its stamp.
#[derive(Debug, Default)]
pub(crate) struct Repeats {
    seen: VecDeque<(Time, bool)>,
    /// The transport (whether the raw one) whose last frame could not be used: its frames do not hide those of the other.
    distrusted: Option<bool>,
}

/// The kind of an arrival.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// A frame's first.
    New,
    /// The same frame by the other transport.
    OtherTransport,
    /// The same stamp by the same transport.
    Duplicate,
}

impl Repeats {
    /// Records that a frame of this transport could not be used.
    pub(crate) fn distrust(&mut self, is_raw: bool) {
        self.distrusted = Some(is_raw);
    }

    pub(crate) fn arrive(&mut self, stamp: Time, is_raw: bool) -> Arrival {
        let newest = self.seen.iter().map(|(stamp, _)| *stamp).max();
        if newest.is_some_and(|newest| stamp.to_nanos() < newest.to_nanos() - JUMP_NS) {
            self.seen.clear();
        }
        let mut of_stamp = self.seen.iter().filter(|(seen, _)| *seen == stamp);
        if of_stamp.clone().any(|(_, was_raw)| *was_raw == is_raw) {
            return Arrival::Duplicate;
        }
        if of_stamp.any(|(_, was_raw)| self.distrusted != Some(*was_raw)) {
            return Arrival::OtherTransport;
        }
        if self.seen.len() == REMEMBERED {
            self.seen.pop_front();
        }
        self.seen.push_back((stamp, is_raw));
        Arrival::New
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamp(index: i64) -> Time {
        Time::from_nanos(1_700_000_000_000_000_000 + index * 200_000_000)
    }

    #[test]
    fn a_frame_counts_once_by_whichever_transport_comes_first() {
        let mut repeats = Repeats::default();
        assert_eq!(repeats.arrive(stamp(0), true), Arrival::New);
        assert_eq!(repeats.arrive(stamp(0), false), Arrival::OtherTransport);
        assert_eq!(repeats.arrive(stamp(1), false), Arrival::New);
        assert_eq!(repeats.arrive(stamp(2), false), Arrival::New);
        assert_eq!(repeats.arrive(stamp(1), true), Arrival::OtherTransport);
        assert_eq!(repeats.arrive(stamp(2), false), Arrival::Duplicate);
    }

    #[test]
    fn a_transport_that_cannot_be_used_does_not_hide_the_other() {
        let mut repeats = Repeats::default();
        assert_eq!(repeats.arrive(stamp(0), true), Arrival::New);
        repeats.distrust(true);
        assert_eq!(repeats.arrive(stamp(0), false), Arrival::New);
        assert_eq!(repeats.arrive(stamp(1), true), Arrival::New);
        assert_eq!(repeats.arrive(stamp(1), false), Arrival::New);
        assert_eq!(repeats.arrive(stamp(1), false), Arrival::Duplicate);
        assert_eq!(repeats.arrive(stamp(2), false), Arrival::New);
        assert_eq!(repeats.arrive(stamp(2), true), Arrival::OtherTransport);
    }

    #[test]
    fn after_a_jump_back_frames_are_new_again() {
        let mut repeats = Repeats::default();
        for index in 0..12 {
            assert_eq!(repeats.arrive(stamp(index), true), Arrival::New);
        }
        for index in 0..12 {
            assert_eq!(repeats.arrive(stamp(index), true), Arrival::New);
        }
    }
}
