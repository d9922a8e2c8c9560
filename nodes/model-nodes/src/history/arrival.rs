//! The effect of an input on a history.

use super::{CameraStep, seconds_of};

/// The effect of an input on the history.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Arrival {
    /// A new epoch has begun, and earlier observations are dropped.
    pub flushed: bool,
    /// The clock of the camera has stepped, and that of the actions has not.
    pub camera_step: Option<CameraStep>,
    /// The frame may be the first after a jump of time: it is held back until the next frame confirms the jump.
    /// [`History::moment`](super::History::moment) is still that of the frame before.
    pub held_back: bool,
    /// Inputs that were held back for a jump of time that did not come.
    pub untimely: u64,
    /// Camera frames that are missing between this frame and the one before. A slow encoder skips frames on purpose: regular
    /// gaps are not counted.
    pub missed_frames: u64,
    /// Whether a model step is due: frames faster than the model's are kept, but not each is worth a prediction. Of a
    /// chunk: whether it answers the newest frame.
    pub is_due: bool,
    /// A chunk that arrived since the frame before and had already ended: it is not used.
    pub late_chunk: Option<LateChunk>,
}

/// A chunk that came after its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LateChunk {
    /// Its stamp.
    pub stamp_ns: i64,
    /// When its last action ends.
    pub end_ns: i64,
    /// The newest frame when it came.
    pub newest_ns: i64,
}

impl std::fmt::Display for LateChunk {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "action chunk of {} had ended {:.1} s before the newest frame, that of {}, when it arrived: stamp it with \
             the stamp of the image that it answers",
            seconds_of(self.stamp_ns),
            (self.newest_ns.saturating_sub(self.end_ns)) as f64 / 1e9,
            seconds_of(self.newest_ns)
        )
    }
}
