//! The findings of a survey.

use std::fmt;

use super::{Range, Rounded};
use crate::actions::Kind;

/// The likely reason for values that contradict their kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cause {
    /// Positions instead of changes.
    Absolute,
    /// Angles are in degrees.
    Degrees,
    /// Lengths are in millimetres.
    Millimetres,
    /// Values scaled to -1 to 1.
    Normalised,
    /// A gripper with another range.
    Gripper {
        /// Presumed value of a closed gripper.
        closed: f32,
        /// Presumed value of an open gripper.
        open: f32,
    },
    /// Motion too fast for any arm.
    TooFar,
}

/// Values that contradict their kind.
#[derive(Clone, Debug, PartialEq)]
pub struct Contradiction {
    /// Name of the dimension.
    pub column: String,
    /// Unit of the dimension.
    pub unit: String,
    /// Kind of the dimension.
    pub kind: Kind,
    /// Rate of the actions \[Hz\].
    pub rate: f64,
    /// Range in the data.
    pub measured: Range,
    /// Range possible for the kind.
    pub expected: Range,
    /// The likely reason.
    pub cause: Cause,
}

impl fmt::Display for Contradiction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            column,
            measured,
            expected,
            ..
        } = self;
        let unit = match self.unit.as_str() {
            "1" => String::new(),
            unit => format!(" {unit}"),
        };
        write!(f, "{column}: measured {measured}{unit}")?;
        match self.cause {
            Cause::Gripper { .. } => {
                write!(f, "; expected {} (closed) to ", Rounded(expected.low))?;
                write!(f, "{} (open){unit}", Rounded(expected.high))?;
            }
            Cause::Absolute => write!(
                f,
                "; as {}s at {} Hz, the sum exceeds any arm's reach",
                self.kind.name(),
                self.rate_rounded()
            )?,
            _ => write!(
                f,
                "; a {} at {} Hz is at most {}{unit}",
                self.kind.name(),
                self.rate_rounded(),
                Rounded(expected.high)
            )?,
        }
        match self.cause {
            Cause::Absolute => write!(f, ": probably absolute positions"),
            Cause::Degrees => write!(f, ": probably degrees"),
            Cause::Millimetres => write!(f, ": probably millimetres"),
            Cause::Normalised => write!(f, ": probably values scaled to -1 to 1"),
            Cause::Gripper { .. } => Ok(()),
            Cause::TooFar => write!(f, ": no arm moves so fast"),
        }
    }
}

impl Contradiction {
    fn rate_rounded(&self) -> f64 {
        (self.rate * 100.0).round() / 100.0
    }
}

/// An unusual but possible finding.
#[derive(Clone, Debug, PartialEq)]
pub enum Hint {
    /// The gripper never reaches one of its ends.
    GripperRange {
        /// Name of the dimension.
        column: String,
        /// Range in the data.
        measured: Range,
    },
    /// Most episodes begin with a closed gripper.
    GripperInverted {
        /// Name of the dimension.
        column: String,
        /// Episodes that begin closed.
        begin_closed: usize,
        /// Episodes in which the gripper moves.
        episodes: usize,
        /// Range in the data.
        measured: Range,
    },
    /// The gripper closes when its action opens.
    GripperOpposed {
        /// Range in the data.
        measured: Range,
    },
    /// Most episodes begin with a zero action.
    FirstZero {
        /// Episodes with such an action.
        zero: usize,
        /// Episodes in all.
        episodes: usize,
    },
    /// The state follows the actions later or earlier than by one frame.
    Lag {
        /// Frames of delay; negative if the state is early.
        frames: i64,
    },
    /// State change and action differ in size.
    Scale {
        /// Name of the dimension.
        column: String,
        /// State change per unit of action.
        factor: f64,
    },
}

impl Hint {
    /// Whether open and closed may be exchanged.
    #[must_use]
    pub fn is_inverted(&self) -> bool {
        matches!(
            self,
            Self::GripperInverted { .. } | Self::GripperOpposed { .. }
        )
    }
}

impl fmt::Display for Hint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::GripperRange { column, measured } => write!(
                f,
                "{column}: measured {measured}; never reaches both closed (0) and open (1)"
            ),
            Self::GripperInverted {
                column,
                begin_closed,
                episodes,
                measured,
            } => write!(
                f,
                "{column}: measured {measured}; {begin_closed} of {episodes} episodes begin with a closed gripper; in this data set, 0 may mean \
                 open"
            ),
            Self::GripperOpposed { measured } => write!(
                f,
                "gripper: measured {measured}; the state closes when the action opens; in this data set, 0 may mean open"
            ),
            Self::FirstZero { zero, episodes } => write!(
                f,
                "the first action of {zero} of {episodes} episodes is zero: actions may belong to the previous frame"
            ),
            Self::Lag { frames } if *frames < 0 => write!(
                f,
                "the state changes {} frames before the action: actions may belong to an earlier frame",
                -frames
            ),
            Self::Lag { frames } => write!(f, "the state follows the actions {frames} frames late"),
            Self::Scale { column, factor } => write!(
                f,
                "{column}: the state changes by {} of the action, which may be a velocity or in another unit",
                Rounded(*factor as f32)
            ),
        }
    }
}
