//! Why a context is not complete yet.

use thiserror::Error;

use super::{CameraStep, seconds_of};

/// Why there is no context yet. None of these is a fault: each passes when more has arrived.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum Wait {
    /// No frame at all.
    #[error("no frame has arrived yet")]
    NoFrame,
    /// The history is still short.
    #[error("{have} of {need} context frames have arrived")]
    Context {
        /// Context frames at hand.
        have: usize,
        /// Context frames that the model needs.
        need: usize,
    },
    /// A frame that the context needs is missing.
    #[error("the frame of {} is missing: a gap in the context", seconds_of(*.missing_ns))]
    Gap {
        /// Where it should be.
        missing_ns: i64,
    },
    /// The camera is slower than the model's frames.
    #[error(
        "there is a frame every {camera_s:.2} s, but the model needs one every {frame_s:.2} s: if the camera is that slow, \
         use a faster one, or set frame_period:={camera_s:.2} on all nodes of the model to predict in steps of {step_s:.2} \
         s; if the camera is faster, the encoder leaves frames out: its log says why"
    )]
    SlowCamera {
        /// From one of its frames to the next \[s\].
        camera_s: f64,
        /// What the model needs \[s\].
        frame_s: f64,
        /// A model step at the camera's rate \[s\].
        step_s: f64,
    },
    /// No action covers the newest frame.
    #[error("no action has arrived that is stamped {} or earlier, which the newest frame needs", seconds_of(*.needed_ns))]
    NoAction {
        /// The moment whose action is needed.
        needed_ns: i64,
    },
    /// The camera has stopped.
    #[error(
        "the camera has stopped: nothing is planned or assessed from its frames until its picture changes (the reason is on \
         /wm/camera_state and on /diagnostics)"
    )]
    Frozen,
    /// The camera's clock has stepped.
    #[error("nothing is planned or assessed: {0}")]
    CameraClock(CameraStep),
    /// The newest frame is too old to act on.
    #[error(
        "the newest frame arrived {age_s:.1} s ago; at most {max_s:.1} s are accepted (max_age)"
    )]
    Stale {
        /// Since it was received \[s\].
        age_s: f64,
        /// The greatest age \[s\].
        max_s: f64,
    },
}

impl Wait {
    /// One word: waits of one kind are logged once.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::NoFrame => "no frame",
            Self::Context { .. } => "context",
            Self::Gap { .. } => "gap",
            Self::SlowCamera { .. } => "slow camera",
            Self::NoAction { .. } => "no action",
            Self::Frozen => "frozen camera",
            Self::CameraClock(_) => "camera clock",
            Self::Stale { .. } => "stale",
        }
    }

    /// Whether every start passes through this wait.
    pub fn is_usual(&self) -> bool {
        matches!(self, Self::NoFrame | Self::Context { .. })
    }
}
