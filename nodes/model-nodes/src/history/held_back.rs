//! Messages that may be the first after a jump of time.

use std::{collections::BTreeMap, sync::Arc};

use wm_motion::{
    actions::ActionSpace,
    motion::{Chunk, Motion},
};

use super::Frame;

/// Most actions that are held back: in a loop, those that arrive before the first frame.
const MOST: usize = 64;

/// Inputs that are held back until the next frame confirms or refutes a jump of time.
#[derive(Clone, Debug, Default)]
pub(super) struct HeldBack {
    frame: Option<Frame>,
    actions: BTreeMap<i64, Arc<[f32]>>,
    chunk: Option<Chunk>,
    /// Inputs dropped because there was no room.
    lost: u64,
}

impl HeldBack {
    /// Holds a frame back. Returns it with the one held back before if they are at most `jump_ns` apart.
    pub fn confirm(&mut self, frame: Frame, jump_ns: i64) -> Option<(Frame, Frame)> {
        let follows = |before: &Frame| {
            let since_ns = frame.stamp_ns.saturating_sub(before.stamp_ns);
            since_ns > 0 && since_ns <= jump_ns
        };
        match self.frame.take() {
            Some(before) if follows(&before) => Some((before, frame)),
            before => {
                self.lost += u64::from(before.is_some());
                self.frame = Some(frame);
                None
            }
        }
    }

    pub fn action(&mut self, stamp_ns: i64, values: Arc<[f32]>) {
        self.actions.insert(stamp_ns, values);
        while self.actions.len() > MOST {
            self.actions.pop_first();
            self.lost += 1;
        }
    }

    pub fn chunk(&mut self, chunk: Chunk) {
        let before = self.chunk.replace(chunk);
        self.lost += u64::from(before.is_some());
    }

    /// Passes inputs of the time around `stamp_ns` to `motion`.
    pub fn release(
        &mut self,
        motion: &mut Motion,
        space: &ActionSpace,
        stamp_ns: i64,
        margin_ns: i64,
    ) {
        let is_near =
            |other_ns: i64| other_ns.saturating_sub(stamp_ns).saturating_abs() <= margin_ns;
        for (stamp_ns, values) in std::mem::take(&mut self.actions) {
            if is_near(stamp_ns) {
                motion.take(stamp_ns, values);
            } else {
                self.lost += 1;
            }
        }
        if let Some(chunk) = self.chunk.take() {
            if is_near(chunk.stamp_ns()) {
                motion.announce(chunk, space);
            } else {
                self.lost += 1;
            }
        }
    }

    /// Drops all, because time has not jumped. Returns how many inputs were lost.
    pub fn discard(&mut self) -> u64 {
        let frame = u64::from(self.frame.take().is_some());
        let chunk = u64::from(self.chunk.take().is_some());
        let actions = std::mem::take(&mut self.actions).len() as u64;
        frame + chunk + actions + std::mem::take(&mut self.lost)
    }
}
