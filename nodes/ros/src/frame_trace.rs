//! The latency of a camera frame by stage, from its capture to its predictions.
//!
//! Each node logs the stages of a frame with their times, at debug level, by the frame's capture stamp. With
//! `--log-level wm_ros.frame_trace:=debug` the records of all nodes trace every frame; `benches/frame.py` makes a table
//! of them. Without it a stage costs one comparison.
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

/// As [`passed`], at an earlier moment.
pub fn passed_at(stage: &str, frame: Time, at: Instant) {
    step_passed_at(stage, frame, 0, at);
}

/// As [`passed`], of step k of the prediction from that frame.
pub fn step_passed(stage: &str, frame: Time, step: u32) {
    if is_on() {
        note(stage, frame, step, system_nanos());
    }
}

/// As [`step_passed`], at an earlier moment.
pub fn step_passed_at(stage: &str, frame: Time, step: u32, at: Instant) {
    if is_on() {
        // a difference of centuries overflows the type
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::{
        fmt::{Debug, Write as _},
        sync::{Arc, Mutex},
    };
    use tracing::{Event, Level, Subscriber, field::Field};
    use tracing_subscriber::{
        Layer,
        filter::Targets,
        layer::{Context, SubscriberExt as _},
    };

    /// The texts of all records.
    #[derive(Clone, Default)]
    struct Kept(Arc<Mutex<String>>);

    impl<S: Subscriber> Layer<S> for Kept {
        fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
            let mut text = self.0.lock().unwrap();
            event.record(&mut |field: &Field, value: &dyn Debug| {
                write!(text, "{}={value:?} ", field.name()).unwrap();
            });
        }
    }

    #[test]
    fn stages_are_told_with_their_frame_and_moment_to_who_asks() {
        let frame = Time::from_nanos(1_700_000_000_000_000_042);
        let told = |level: Level| {
            let kept = Kept::default();
            let filter = Targets::new()
                .with_default(Level::INFO)
                .with_target(TARGET, level);
            let subscriber = tracing_subscriber::registry().with(kept.clone().with_filter(filter));
            let before = system_nanos();
            tracing::subscriber::with_default(subscriber, || {
                step_passed_at("step received", frame, 3, Instant::now());
            });
            (before, kept.0.lock().unwrap().clone(), system_nanos())
        };
        assert_eq!(told(Level::INFO).1, "");
        let (before, text, after) = told(Level::DEBUG);
        let (rest, at) = text.trim_end().rsplit_once(" at=").unwrap();
        let expected = "message=step received frame=1700000000000000042 step=3";
        assert_eq!(rest, expected);
        let at: i64 = at.parse().unwrap();
        assert!((before..=after).contains(&at), "{before} {at} {after}");
    }
}
