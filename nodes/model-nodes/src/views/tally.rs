//! The numbers of a camera on `/diagnostics`.

use std::time::Duration;

use wm_ros::{Diagnostics, Latency};

/// Counts what became of a camera's frames.
pub(super) struct Tally {
    topic: String,
    used: u64,
    skipped: u64,
    dropped: u64,
    lag: Latency,
    diagnostics: Diagnostics,
}

impl Tally {
    /// Of the camera of an absolute topic.
    pub fn new(topic: &str, diagnostics: Diagnostics) -> Self {
        let tally = Self {
            topic: topic.to_owned(),
            used: 0,
            skipped: 0,
            dropped: 0,
            lag: diagnostics.latency(&format!("capture to receipt, {topic}")),
            diagnostics,
        };
        tally.report();
        tally
    }

    /// Records the time from a frame's capture to its receipt.
    pub fn lag(&self, lag: Duration) {
        self.lag.record(lag);
    }

    /// Counts a frame in a picture, `offset_ns` after the first camera's.
    pub fn used(&mut self, offset_ns: i64) {
        self.used += 1;
        let key = format!("stamp after the first camera's, {} [ms]", self.topic);
        let offset_ms = offset_ns as f64 / 1e6;
        self.diagnostics.set_value(&key, format!("{offset_ms:.1}"));
        self.report();
    }

    /// Counts a frame that no picture needs.
    pub fn skipped(&mut self) {
        self.skipped += 1;
        self.report();
    }

    /// Counts a frame that is lost.
    pub fn dropped(&mut self) {
        self.dropped += 1;
        self.report();
    }

    fn report(&self) {
        let counts = [
            ("used", self.used),
            ("skipped", self.skipped),
            ("dropped", self.dropped),
        ];
        for (kind, count) in counts {
            let key = format!("frames {kind}, {} [total]", self.topic);
            self.diagnostics.set_value(&key, count);
        }
    }
}
