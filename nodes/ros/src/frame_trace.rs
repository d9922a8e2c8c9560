//! Where the time of a camera frame goes, from its capture to the predictions that it leads to.
//!
//! Each node says which stages a frame has passed, and when, as log records at debug level with the frame's capture stamp.
//! With `--log-level wm_ros.frame_trace:=debug` for all nodes, their records together are the way of every frame;
//! `benches/frame.py` makes a table of them. Without it a stage costs one comparison.
//!
//! ```text
//! [DEBUG] [1764013800.123456789] [wm.encoder]: picture decoded frame=1764013800120000000 step=0 at=1764013800123450000
//! ```

use crate::clock::system_nanos;
use std::time::Instant;
use wm_msgs::builtin_interfaces::Time;

/// The records' target. They are not on `/rosout`: sending them would take part of the time that they measure.
pub(crate) const TARGET: &str = module_path!();

/// The frame that was captured at `frame` has passed `stage` now.
pub fn passed(stage: &str, frame: Time) {
    step_passed(stage, frame, 0);
}

/// As [`passed`], at a moment that has gone by.
pub fn passed_at(stage: &str, frame: Time, at: Instant) {
    step_passed_at(stage, frame, 0, at);
}

/// As [`passed`], of step k of the prediction from that frame.
pub fn step_passed(stage: &str, frame: Time, step: u32) {
    if is_on() {
        note(stage, frame, step, system_nanos());
    }
}

/// As [`step_passed`], at a moment that has gone by.
pub fn step_passed_at(stage: &str, frame: Time, step: u32, at: Instant) {
    if is_on() {
        // centuries do not fit into the type
        let ago = i64::try_from(at.elapsed().as_nanos()).unwrap_or(i64::MAX);
        note(stage, frame, step, system_nanos().saturating_sub(ago));
    }
}

fn is_on() -> bool {
    tracing::enabled!(tracing::Level::DEBUG)
}

fn note(stage: &str, frame: Time, step: u32, at: i64) {
    tracing::debug!(frame = frame.to_nanos(), step, at, "{stage}");
}
