//! The usual time from one frame of a camera to the next.

use std::collections::VecDeque;

/// Number of gaps that are kept; their median counts.
const RECENT: usize = 8;

/// The last gaps between the stamps of a camera.
#[derive(Clone, Debug, Default)]
pub(super) struct Gaps(VecDeque<i64>);

impl Gaps {
    /// Adds the time from one frame to the next, above 0 \[ns\].
    pub fn push(&mut self, gap_ns: i64) {
        if self.0.len() == RECENT {
            self.0.pop_front();
        }
        self.0.push_back(gap_ns);
    }

    /// Half of the gaps are no longer \[ns\]; `None` before the second frame.
    pub fn usual_ns(&self) -> Option<i64> {
        let mut sorted: Vec<i64> = self.0.iter().copied().collect();
        sorted.sort_unstable();
        sorted.get(sorted.len() / 2).copied()
    }
}
