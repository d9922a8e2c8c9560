//! How stamps are grouped into model steps.

use std::time::Duration;

use wm_motion::actions::ActionEncoding;

/// A shorter `frame_period` stands for that of the training \[s\].
const SHORTEST_S: f64 = 1e-3;

/// How stamps are grouped into model steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// From one camera frame to the next, as the model counts them \[ns\].
    pub frame_period_ns: i64,
    /// Camera frames of one model step.
    pub frame_skip: usize,
    /// Tolerance when a frame or action is looked up by stamp \[ns\].
    pub tolerance_ns: i64,
    /// Distance of a stamp from the newest that means a jump of time, not a late or lost message \[ns\].
    pub jump_ns: i64,
}

impl Timing {
    /// Timing of a camera with `frame_period` \[s\] between frames, or 0 for that of the training, for a model with this
    /// encoding of actions.
    pub fn of_camera(frame_period: f64, encoding: &ActionEncoding) -> Self {
        let period_s = match frame_period < SHORTEST_S {
            true => encoding.space().rate().recip(),
            false => frame_period,
        };
        // The parameter's descriptor and the action space keep it within a minute.
        Self::new((period_s * 1e9).round() as i64, encoding.frame_skip())
    }

    /// From one camera frame to the next.
    pub fn frame_period(&self) -> Duration {
        Duration::from_nanos(self.frame_period_ns.unsigned_abs())
    }

    /// Timing of a camera with `frame_period_ns` between frames: a quarter of that as tolerance; five of them, and at
    /// least a second, as jump.
    pub fn new(frame_period_ns: i64, frame_skip: usize) -> Self {
        let frame_period_ns = frame_period_ns.max(1);
        Self {
            frame_period_ns,
            frame_skip: frame_skip.max(1),
            tolerance_ns: frame_period_ns / 4,
            jump_ns: frame_period_ns.saturating_mul(5).max(1_000_000_000),
        }
    }

    /// One model step \[ns\].
    pub fn step_ns(&self) -> i64 {
        // A skip is a handful of frames.
        self.frame_period_ns.saturating_mul(self.frame_skip as i64)
    }

    /// Begin of the model step number `index` after one that begins at `start_ns` \[ns\].
    pub fn step_at(&self, start_ns: i64, index: usize) -> i64 {
        // Horizons are a handful of steps.
        start_ns.saturating_add(self.step_ns().saturating_mul(index as i64))
    }

    /// Begins of the camera frames within the model step that begins at `start_ns` \[ns\].
    pub fn slots(self, start_ns: i64) -> impl Iterator<Item = i64> {
        (0..self.frame_skip as i64).map(move |index| start_ns + index * self.frame_period_ns)
    }
}
