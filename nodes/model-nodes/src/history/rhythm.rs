//! The gaps between frames of an encoder that skips some.

use std::{collections::VecDeque, time::Duration};

use super::{Reception, Timing};

/// Number of gaps that are kept.
const RECENT: usize = 8;
/// A gap that occurs this often is the encoder's choice, not a loss.
const USUAL: usize = 2;
/// A bag may be played faster than it was recorded, by this much.
const FASTEST_PLAYBACK: u32 = 10;

/// The last gaps between frames, and whether contexts become complete.
#[derive(Clone, Debug, Default)]
pub(super) struct Rhythm {
    gaps_ns: VecDeque<i64>,
    /// Frames since the last one with a complete context; `None` if no context was ever complete.
    incomplete: Option<usize>,
}

impl Rhythm {
    /// Records the time from one frame to the next; returns the number of missing frames in between.
    pub fn missed(&mut self, gap_ns: i64, timing: &Timing) -> u64 {
        let period_ns = timing.frame_period_ns;
        let periods = gap_ns.saturating_add(period_ns / 2) / period_ns;
        let as_long = (self.gaps_ns.iter()).filter(|other_ns| **other_ns > gap_ns - period_ns / 2);
        // A gap beyond a jump is one that time explains: the camera was away, or the encoder is that slow.
        let is_usual = gap_ns > timing.jump_ns || as_long.count() >= USUAL;
        if self.gaps_ns.len() == RECENT {
            self.gaps_ns.pop_front();
        }
        self.gaps_ns.push_back(gap_ns);
        match is_usual {
            true => 0,
            // A gap of less than a period misses no frame.
            false => u64::try_from(periods - 1).unwrap_or(0),
        }
    }

    /// The longest of the last gaps \[ns\].
    pub fn longest_ns(&self) -> i64 {
        // 0 before the second frame.
        self.gaps_ns.iter().max().copied().unwrap_or(0)
    }

    /// Records whether the newest frame has a complete context.
    pub fn context(&mut self, is_whole: bool) {
        self.incomplete = match (is_whole, self.incomplete) {
            (true, _) => Some(0),
            (false, incomplete) => incomplete.map(|frames| frames.saturating_add(1)),
        };
    }

    /// Whether the newest frame has no whole context, and those of the next `need` frames may have one.
    pub fn is_between(&self, need: usize) -> bool {
        self.incomplete
            .is_some_and(|frames| frames > 0 && frames < need)
    }
}

/// The time between the arrivals of two frames \[ns\]: by the node's clock, or by the monotonic clock if a bag is
/// played fast.
pub(super) fn passed_ns(before: &Reception, now: &Reception) -> i64 {
    let nanos = |time: Duration| i64::try_from(time.as_nanos()).unwrap_or(i64::MAX);
    let real_ns = nanos(now.at.saturating_duration_since(before.at) * FASTEST_PLAYBACK);
    let (before_ns, now_ns) = (before.stamp.to_nanos(), now.stamp.to_nanos());
    // A node that waits for /clock has no time yet.
    match before_ns {
        0 => real_ns,
        before_ns => real_ns.max(now_ns.saturating_sub(before_ns)),
    }
}
