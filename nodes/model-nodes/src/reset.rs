//! The service `reset` of the nodes that hold a history.

use wm_msgs::wm_msgs::{Reset, ResetResponse};
use wm_ros::{Call, calls::answer};

/// Answers a reset with what `reset` says that it did; the seed is none where the node keeps its own.
pub(crate) fn answer_reset(call: Call<Reset>, reset: impl FnOnce(Option<u64>) -> String) {
    let seed = (!call.request.keep_seed).then_some(call.request.seed);
    let message = reset(seed);
    tracing::info!("reset: {message}");
    let success = true;
    answer(call, &ResetResponse { success, message });
}
