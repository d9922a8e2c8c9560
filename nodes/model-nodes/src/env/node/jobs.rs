//! Jobs of the env's thread, and the clients that wait for their results.

use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{EnvReset, EnvResetRequest, EnvResetResponse, EnvStep, EnvStepRequest},
};
use wm_ros::Call;

use super::super::{EnvError, Move, Moved, Observation, Start};

/// A job of the env's thread.
pub(super) enum Job {
    Reset {
        request: EnvResetRequest,
        start: Start,
        begin: Time,
    },
    Step(Vec<Move>),
}

/// The result of a job, and its time.
pub(super) enum JobResult {
    Reset(Result<Box<(EnvResetResponse, Observation)>, EnvError>),
    Step {
        moved: Vec<Result<Moved, EnvError>>,
        start: Time,
        end: Time,
    },
}

/// The client that waits for the answer to a reset; the topics count as one.
pub(super) enum Resetter {
    Service(Box<Call<EnvReset>>),
    Topics,
}

/// The client that waits for the answer to a step; the topics count as one.
pub(super) enum Stepper {
    Service { call: Call<EnvStep>, received: Time },
    Topics,
}

/// The clients of the running job.
pub(super) enum RunningJob {
    Nothing,
    Reset(Resetter),
    Steps(Vec<Stepper>),
}

/// The move that a call requests.
pub(super) fn as_move(request: &EnvStepRequest) -> Move {
    Move {
        episode_id: request.episode_id.clone(),
        actions: request.actions.clone(),
        close: request.close,
        outcome: match request.outcome {
            EnvStepRequest::SUCCESS => Some(true),
            EnvStepRequest::FAILURE => Some(false),
            _ => None,
        },
    }
}
