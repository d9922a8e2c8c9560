//! What a survey finds, in words.

use std::fmt;

use super::{Range, Rounded};
use crate::actions::Kind;

/// Why values are not of their kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cause {
    /// They are places, not changes.
    Absolute,
    /// Angles are in degrees.
    Degrees,
    /// Lengths are in millimetres.
    Millimetres,
    /// They are scaled to -1 to 1.
    Normalised,
    /// The gripper has another range.
    Gripper {
        /// The value of a closed gripper, presumably.
        closed: f32,
        /// The value of an open gripper, presumably.
        open: f32,
    },
    /// The robot cannot move so far in this time.
    TooFar,
}

/// Values that contradict their kind.
#[derive(Clone, Debug, PartialEq)]
pub struct Contradiction {
    /// The dimension's name.
    pub column: String,
    /// Its unit.
    pub unit: String,
    /// Its kind.
    pub kind: Kind,
    /// Rate of the actions \[Hz\].
    pub rate: f64,
    /// What the data have.
    pub measured: Range,
    /// What the kind can be.
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
                "; as {}s at {} Hz they lead out of any arm's reach",
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
            Cause::Absolute => write!(f, ": they look like absolute positions"),
            Cause::Degrees => write!(f, ": they look like degrees"),
            Cause::Millimetres => write!(f, ": they look like millimetres"),
            Cause::Normalised => write!(f, ": they look like values scaled to -1 to 1"),
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

/// What looks unusual in a data set, and may be right.
#[derive(Clone, Debug, PartialEq)]
pub enum Hint {
    /// The gripper never reaches one of its ends.
    GripperRange {
        /// The dimension's name.
        column: String,
        /// What the data have.
        measured: Range,
    },
    /// Most episodes begin with a closed gripper.
    GripperInverted {
        /// The dimension's name.
        column: String,
        /// Episodes that begin closed.
        begin_closed: usize,
        /// Episodes in which the gripper moves.
        episodes: usize,
        /// What the data have.
        measured: Range,
    },
    /// The gripper's state goes against its action.
    GripperOpposed {
        /// What the data have.
        measured: Range,
    },
    /// The first action is zero.
    FirstZero {
        /// Episodes with such an action.
        zero: usize,
        /// Episodes.
        episodes: usize,
    },
    /// The state follows the actions later, or earlier, than by one frame.
    Lag {
        /// Frames by which it is late; negative if it is early.
        frames: i64,
    },
    /// The state changes by another amount than the action.
    Scale {
        /// The dimension's name.
        column: String,
        /// Change of the state in one unit of the action.
        factor: f64,
    },
}

impl Hint {
    /// Whether it says that open and closed may be exchanged.
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
                "{column}: measured {measured}; it never reaches both closed (0) and open (1)"
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
                "gripper: measured {measured}; its state closes if its action opens; in this data set, 0 may mean open"
            ),
            Self::FirstZero { zero, episodes } => write!(
                f,
                "the first action of {zero} of {episodes} episodes is zero: actions may belong to the frame before"
            ),
            Self::Lag { frames } if *frames < 0 => write!(
                f,
                "the state changes {} frames before the action: actions may belong to an earlier frame",
                -frames
            ),
            Self::Lag { frames } => write!(f, "the state follows the actions {frames} frames late"),
            Self::Scale { column, factor } => write!(
                f,
                "{column}: the state changes by {} of the action: it may be a velocity, or in another unit",
                Rounded(*factor as f32)
            ),
        }
    }
}
