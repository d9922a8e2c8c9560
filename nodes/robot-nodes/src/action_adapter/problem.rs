//! Problems of messages that give no action.

use thiserror::Error;
use wm_motion::actions::ActionError;
use wm_wire::frames::{TransformError, pose::PoseError};

/// A problem of a message that gives no action.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum Problem {
    /// A value that is not finite.
    #[error("{what} has {value}; expected finite numbers")]
    NotFinite {
        /// The message.
        what: &'static str,
        /// What came.
        value: f64,
    },
    /// A quaternion that is no orientation.
    #[error("the quaternion of {what} has the norm {norm}; expected 1, within 1 %")]
    NotUnit {
        /// The message.
        what: &'static str,
        /// What came.
        norm: f64,
    },
    /// Motions in another frame.
    #[error("the frame of {what} is {actual:?}; expected base_frame, {expected:?}")]
    Frame {
        /// The message.
        what: &'static str,
        /// The parameter.
        expected: String,
        /// What came.
        actual: String,
    },
    /// An invalid stamp.
    #[error("the stamp of {what} is {sec} s and {nanosec} ns")]
    Stamp {
        /// The message.
        what: &'static str,
        /// Its seconds.
        sec: i32,
        /// Its nanoseconds.
        nanosec: u32,
    },
    /// A message that is not newer than the one before.
    #[error("{what} is stamped {before_s:.3} s before the one that came before it")]
    Older {
        /// The message.
        what: &'static str,
        /// By how much \[s\].
        before_s: f64,
    },
    /// A message that arrived after its period was closed: its data of that period are lost.
    #[error("{what} came when {late_s:.3} s of its time were over already: do the clocks agree?")]
    Late {
        /// The message.
        what: &'static str,
        /// How much of its time \[s\].
        late_s: f64,
    },
    /// Stamps went back: a bag begins again, or a clock was set.
    #[error("stamps of {what} went back by {by_s:.3} s: begun anew")]
    Jump {
        /// The message.
        what: &'static str,
        /// By how much \[s\].
        by_s: f64,
    },
    /// A pose further from the last one than the arm can go in that time.
    #[error(
        "{what} is {way:.3} m and {turn:.3} rad from the last one, {seconds:.3} s before; at most {most_way:.3} m and \
         {most_turn:.3} rad are possible (max_linear_speed, max_angular_speed)"
    )]
    Leap {
        /// The message.
        what: &'static str,
        /// How far \[m\].
        way: f64,
        /// By how much it is turned \[rad\].
        turn: f64,
        /// Since the last one \[s\].
        seconds: f64,
        /// How far the arm goes in that time \[m\].
        most_way: f64,
        /// How far it turns in that time \[rad\].
        most_turn: f64,
    },
    /// Poses that stay where they leapt to, as after a change of the tool or of the base's place.
    #[error(
        "{what} stays where it leapt to: begun anew from there; nothing is known of {periods} periods"
    )]
    Moved {
        /// The message.
        what: &'static str,
        /// How many.
        periods: u64,
    },
    /// A velocity that the arm does not have.
    #[error(
        "twist is {linear:.3} m/s and {angular:.3} rad/s; at most {most_linear} m/s and {most_angular} rad/s are possible \
         (max_linear_speed, max_angular_speed)"
    )]
    TooFast {
        /// \[m/s\]
        linear: f64,
        /// \[rad/s\]
        angular: f64,
        /// The parameter \[m/s\].
        most_linear: f64,
        /// The parameter \[rad/s\].
        most_angular: f64,
    },
    /// The source was silent.
    #[error("nothing is known of {periods} periods: {what} was silent for {silent_s:.3} s")]
    Gap {
        /// The message.
        what: &'static str,
        /// How many.
        periods: u64,
        /// For how long \[s\].
        silent_s: f64,
    },
    /// No opening of the gripper has arrived.
    #[error("nothing is known of the gripper yet")]
    NoGripper,
    /// A motion beyond any robot.
    #[error(transparent)]
    Action(#[from] ActionError),
    /// More frames than are kept.
    #[error("the frame {0:?} is one too many: more are not kept")]
    Frames(String),
}

impl From<TransformError> for Problem {
    fn from(left_out: TransformError) -> Self {
        match left_out {
            TransformError::Older { before_s } => Self::Older {
                what: "tf",
                before_s,
            },
            TransformError::TooMany(frame) => Self::Frames(frame),
        }
    }
}

impl Problem {
    /// Of a pose in a message of this kind.
    pub(super) fn of_pose(what: &'static str, error: PoseError) -> Self {
        match error {
            PoseError::NotFinite(value) => Self::NotFinite { what, value },
            PoseError::NotUnit(norm) => Self::NotUnit { what, norm },
        }
    }

    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::NotFinite { .. } => "not_finite",
            Self::NotUnit { .. } => "not_unit",
            Self::Frame { .. } => "wrong_frame",
            Self::Stamp { .. } => "bad_stamp",
            Self::Older { .. } => "older",
            Self::Late { .. } => "late",
            Self::Jump { .. } => "clock_jumped",
            Self::Leap { .. } => "pose_leapt",
            Self::Moved { .. } => "pose_moved",
            Self::TooFast { .. } => "too_fast",
            Self::Gap { .. } => "gap",
            Self::NoGripper => "no_gripper",
            Self::Action(_) => "out_of_bounds",
            Self::Frames(_) => "too_many_frames",
        }
    }

    /// Whether actions begin anew with the pose at which it was found.
    pub(super) fn begins_anew(&self) -> bool {
        matches!(
            self,
            Self::Jump { .. } | Self::Gap { .. } | Self::Moved { .. }
        )
    }

    /// Number of dropped messages.
    pub fn count(&self) -> u64 {
        match self {
            Self::Gap { periods, .. } | Self::Moved { periods, .. } => *periods,
            _ => 1,
        }
    }
}
