//! Why an input is dropped.

use thiserror::Error;
use wm_motion::actions::ActionError;
use wm_msgs::InvalidNanoseconds;
use wm_wire::{latent_message::LatentError, stamp::FutureStamp};

use super::seconds_of;
use crate::camera::WrongCamera;

/// Why a frame, an action or a chunk is dropped.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum HistoryError {
    /// A latent message that cannot be used.
    #[error(transparent)]
    Latent(#[from] LatentError),
    /// An invalid stamp.
    #[error(
        "{what} is stamped {sec} s and {nanosec} ns: expected a time after 1970 and less than 1e9 ns"
    )]
    Stamp {
        /// `frame`, `action` or `action chunk`.
        what: &'static str,
        /// Its seconds.
        sec: i32,
        /// Its nanoseconds.
        nanosec: u32,
    },
    /// A frame, an action or a chunk stamped in the future.
    #[error(transparent)]
    Future(#[from] FutureStamp),
    /// An action of the present, for frames of another clock.
    #[error(
        "{what} dropped: the camera's stamps are {behind_s:.1} s behind this node's clock, and those of the actions are \
         not; set the camera's clock, or have its driver stamp by the system's"
    )]
    CameraBehind {
        /// `action` or `action chunk`.
        what: &'static str,
        /// How far the newest frame was behind when it arrived \[s\].
        behind_s: f64,
    },
    /// The same stamp again.
    #[error("the frame of {} arrived twice: ignored", seconds_of(*.stamp_ns))]
    Duplicate {
        /// Its stamp.
        stamp_ns: i64,
    },
    /// Older than the newest, by less than a jump of time.
    #[error(
        "{what} of {} arrived after that of {}: out of order, dropped",
        seconds_of(*.stamp_ns), seconds_of(*.newest_ns)
    )]
    OutOfOrder {
        /// `frame` or `action chunk`.
        what: &'static str,
        /// Its stamp.
        stamp_ns: i64,
        /// The newest stamp before it.
        newest_ns: i64,
    },
    /// Another camera's frame.
    #[error(transparent)]
    WrongCamera(#[from] WrongCamera),
    /// A latent of a history that is over.
    #[error("latent of epoch {epoch} dropped, because epoch {newest} has begun")]
    OldEpoch {
        /// Its epoch.
        epoch: u64,
        /// The newest epoch of its publisher.
        newest: u64,
    },
    /// Invalid values of an action.
    #[error("{what}: {source}")]
    Action {
        /// Where it came from.
        what: String,
        /// The fault.
        source: ActionError,
    },
    /// A chunk without actions or without times.
    #[error("{0}")]
    Chunk(ActionError),
    /// An invalid period of a chunk.
    #[error("period of an action chunk: {0}")]
    Period(InvalidNanoseconds),
    /// An action or chunk so far ahead that it answers no frame that has come.
    #[error(
        "{what} begins {} s after the newest frame, that of {}: stamp it with the stamp of the image that it answers",
        (*.stamp_ns - *.newest_ns) / 1_000_000_000, seconds_of(*.newest_ns)
    )]
    Ahead {
        /// `action` or `action chunk`.
        what: &'static str,
        /// Its stamp.
        stamp_ns: i64,
        /// The newest frame's.
        newest_ns: i64,
    },
}

impl HistoryError {
    /// Whether it is a latent of another space.
    pub(crate) fn is_other_space(&self) -> bool {
        matches!(self, Self::Latent(LatentError::Space { .. }))
    }

    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Latent(error) => error.reason(),
            Self::Stamp { .. } | Self::Future(_) => "bad_stamp",
            Self::Duplicate { .. } => "duplicate",
            Self::OutOfOrder { .. } => "out_of_order",
            Self::WrongCamera(_) => WrongCamera::REASON,
            Self::OldEpoch { .. } => "old_epoch",
            Self::Ahead { .. } => "untimely_action",
            Self::CameraBehind { .. } => "camera_clock",
            Self::Action { .. } | Self::Chunk(_) | Self::Period(_) => "malformed_action",
        }
    }
}
