//! Answers to calls.

use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{EnvStepResponse, Timing as TimingMessage},
};

use super::super::{EnvError, Moved};

/// The answer to a step. `times` are those of reception, start and end.
pub(super) fn response(
    moved: Result<Moved, EnvError>,
    times: (Time, Time, Time),
) -> EnvStepResponse {
    let (receive, start, end) = times;
    match moved {
        Ok(moved) => EnvStepResponse {
            success: true,
            message: String::new(),
            stamp: moved.stamp,
            steps: moved.steps,
            truncated: moved.truncated,
            // Empty without a bag.
            bag: moved
                .bag
                .map(|bag| bag.display().to_string())
                .unwrap_or_default(),
            timing: TimingMessage {
                capture: moved.capture,
                receive,
                start,
                end,
            },
        },
        Err(error) => EnvStepResponse {
            message: shortened(&error),
            ..EnvStepResponse::default()
        },
    }
}

/// The text of an error in an answer. An answer has to fit into one datagram: RustDDS 0.15.1 writes fragments of a sample
/// with a related sample identity that no peer can read. Images therefore are sent by a topic.
pub(super) fn shortened(error: &dyn std::fmt::Display) -> String {
    const LONGEST: usize = 400;
    error.to_string().chars().take(LONGEST).collect()
}
