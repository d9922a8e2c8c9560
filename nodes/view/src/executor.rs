//! The state of the executor, as the page shows it.

use crate::clip;
use serde::Serialize;
use wm_msgs::wm_msgs::ExecutorStatus;

/// Bytes of the reason.
const MAX_TEXT: usize = 600;

/// The state of the executor.
#[derive(Debug, Serialize)]
pub(crate) struct Executor {
    state: &'static str,
    reason: String,
    begun: u64,
    refused: u64,
    vetoed: u64,
    interrupted: u64,
    #[serde(skip)]
    heard_ns: i64,
}

impl Executor {
    pub(crate) fn of(status: &ExecutorStatus, heard_ns: i64) -> Self {
        Self {
            state: match status.state {
                ExecutorStatus::DRY_RUN => "dry run",
                ExecutorStatus::IDLE => "idle",
                ExecutorStatus::EXECUTING => "executing",
                ExecutorStatus::STOPPING => "stopping",
                ExecutorStatus::STOPPED => "stopped",
                _ => "unknown",
            },
            reason: clip::text(&status.reason, MAX_TEXT),
            begun: status.begun,
            refused: status.refused,
            vetoed: status.vetoed,
            interrupted: status.interrupted,
            heard_ns,
        }
    }

    pub(crate) fn age_ms(&self, now_ns: i64) -> i64 {
        now_ns.saturating_sub(self.heard_ns) / 1_000_000
    }
}
