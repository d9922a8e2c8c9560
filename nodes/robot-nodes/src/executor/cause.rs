//! Why the arm does not move, or moves differently from its offer.

use std::fmt;

use thiserror::Error;

/// A missing condition of every motion.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum Hold {
    /// The node's clock stands still.
    #[error(
        "/clock has not advanced for {timeout_s} s (clock_timeout, or less with a short max_age), but use_sim_time is set"
    )]
    ClockStopped {
        /// The parameter, or less with a short max_age \[s\].
        timeout_s: f64,
    },
    /// The camera's frames are out of date.
    #[error("the camera is frozen: {reason}")]
    CameraFrozen {
        /// From the encoder.
        reason: String,
    },
    /// The encoder no longer reports about the camera.
    #[error("no message on camera_state for more than {timeout_s} s (camera_timeout)")]
    CameraSilent {
        /// The parameter \[s\].
        timeout_s: f64,
    },
    /// No message of the deadman switch has arrived.
    #[error("no message on deadman yet; expected true, since require_deadman is set")]
    NoDeadman,
    /// The deadman switch is released.
    #[error("deadman is false; expected true")]
    DeadmanReleased,
    /// The deadman switch is silent.
    #[error("no message on deadman for more than {timeout_s} s (deadman_timeout)")]
    DeadmanSilent {
        /// The parameter \[s\].
        timeout_s: f64,
    },
    /// No pose of the end effector has arrived.
    #[error("no message on ee_pose yet; expected one, since a workspace box is set")]
    NoPose,
    /// The positions of the joints are unknown.
    #[error(
        "no message on joint_states yet with {name}; expected one, since command_type is joint_trajectory"
    )]
    NoJoints {
        /// The first joint without a position.
        name: String,
    },
    /// A joint has not been measured for too long.
    #[error("no message on joint_states with {name} for more than {timeout_s} s (pose_timeout)")]
    JointsSilent {
        /// The joint.
        name: String,
        /// The parameter \[s\].
        timeout_s: f64,
    },
    /// A joint was measured too long ago, by its stamp.
    #[error(
        "joint_states with {name} comes with stamps more than {timeout_s} s behind this node's clock (pose_timeout): \
         synchronise the clocks of the machines, or have the driver stamp when it measures"
    )]
    JointsOld {
        /// The joint.
        name: String,
        /// The parameter \[s\].
        timeout_s: f64,
    },
    /// The arm does not follow its commands.
    #[error(
        "joint {axis} is {by:.3} from its commanded position; at most {most} is allowed (max_joint_error)"
    )]
    Apart {
        /// Which joint, from 0.
        axis: usize,
        /// How far \[rad or m\].
        by: f64,
        /// The parameter \[rad or m\].
        most: f64,
    },
    /// The pose of the end effector is old, by its stamp.
    #[error(
        "ee_pose comes with stamps more than {timeout_s} s behind this node's clock (pose_timeout): synchronise the clocks \
         of the machines, or have the driver stamp when it measures"
    )]
    PoseOld {
        /// The parameter \[s\].
        timeout_s: f64,
    },
    /// The pose of the end effector is no longer published.
    #[error("no message on ee_pose for more than {timeout_s} s (pose_timeout)")]
    PoseSilent {
        /// The parameter \[s\].
        timeout_s: f64,
    },
}

impl Hold {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::ClockStopped { .. } => "clock_stopped",
            Self::CameraFrozen { .. } => "camera_frozen",
            Self::CameraSilent { .. } => "camera_silent",
            Self::NoDeadman | Self::DeadmanReleased | Self::DeadmanSilent { .. } => "deadman",
            Self::NoPose | Self::PoseSilent { .. } => "no_pose",
            Self::NoJoints { .. } | Self::JointsSilent { .. } => "no_joints",
            Self::PoseOld { .. } => "old_pose",
            Self::JointsOld { .. } => "old_joints",
            Self::Apart { .. } => "not_following",
        }
    }
}

/// Why the arm does not move, or moves differently from its offer.
#[derive(Clone, Debug, PartialEq)]
pub enum Cause {
    /// No chunk or plan to execute.
    Nothing,
    /// The offer has ended, and none followed.
    Silence,
    /// The offer was received too long ago.
    Stale,
    /// The offer has ended by real time, but not by the node's slower clock.
    ClockSlow,
    /// The node's clock jumped ahead, past the offer \[s\].
    ClockAhead(f64),
    /// The planner was reset: its older plans are void.
    OldEpoch,
    /// The offer was vetoed.
    Vetoed,
    /// A condition of motion is missing.
    Held(Hold),
    /// Disarmed while it moved.
    Disarmed,
    /// The node's clock jumped back.
    ClockJump,
    /// A publisher of the emergency stop is gone.
    StopLost,
    /// A publisher of the emergency stop is not connected, and why.
    StopMismatch(String),
    /// The node ends.
    Shutdown,
    /// An emergency stop, and its cause in words.
    Emergency(String),
    /// It moves, but not along these axes (x, y, z): the workspace box ends there.
    Cut([bool; 3]),
    /// It moves, but not all joints: some are at their limits.
    CutJoints,
    /// It moves, but slower than its offer.
    Slowed,
}

impl Cause {
    /// Whether it ended an offer: it holds until the next one begins.
    pub(super) fn is_end(&self) -> bool {
        matches!(
            self,
            Self::Silence
                | Self::Stale
                | Self::ClockSlow
                | Self::ClockAhead(_)
                | Self::OldEpoch
                | Self::Vetoed
        )
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nothing => f.write_str("no chunk or plan"),
            Self::Silence => f.write_str("the last chunk or plan is over, and none followed"),
            Self::Stale => f.write_str("the chunk or plan was received more than max_age ago"),
            Self::ClockSlow => f.write_str(
                "the chunk or plan is over by real time, but not by /clock, which is slower; for a simulated arm, set \
                 command_clock to ros",
            ),
            Self::ClockAhead(by_s) => {
                write!(f, "the clock jumped ahead by {by_s:.2} s, past the chunk or plan")
            }
            Self::OldEpoch => f.write_str("the planner was reset: its older plans are void"),
            Self::Vetoed => f.write_str("the chunk was vetoed while it was executed"),
            Self::Held(hold) => hold.fmt(f),
            Self::Disarmed => f.write_str("disarmed"),
            Self::ClockJump => f.write_str("the clock jumped back: disarmed"),
            Self::StopLost => f.write_str(
                "a publisher of emergency_stop is gone: disarmed",
            ),
            Self::StopMismatch(text) => {
                write!(f, "emergency_stop is not connected: disarmed: {text}")
            }
            Self::Shutdown => f.write_str("the node ends"),
            Self::Emergency(by) => write!(f, "{by}; to go on, call ~/reset, then ~/arm"),
            Self::Cut(axes) => {
                f.write_str("the workspace box ends at")?;
                for (name, is_cut) in ["x", "y", "z"].iter().zip(axes) {
                    if *is_cut {
                        write!(f, " {name}")?;
                    }
                }
                Ok(())
            }
            Self::CutJoints => f.write_str("joints are at their limits"),
            Self::Slowed => f.write_str("slowed down to the velocity limits"),
        }
    }
}
