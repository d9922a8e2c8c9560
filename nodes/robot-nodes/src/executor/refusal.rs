//! Why a chunk or a plan is not executed.

use thiserror::Error;
use wm_motion::{actions::ActionError, motion::MAX_CHUNK};
use wm_msgs::builtin_interfaces::{Duration, Time};
use wm_wire::stamp::FutureStamp;

use super::{Hold, Veto};

/// Why a chunk or a plan is not executed.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum Refusal {
    /// The node is not armed, and makes no dry run.
    #[error("not armed: expected a call of ~/arm")]
    NotArmed,
    /// An emergency stop is latched.
    #[error("stopped: expected a call of ~/reset, then ~/arm")]
    Stopped,
    /// The time is unknown: with `use_sim_time`, no message on `/clock` has arrived.
    #[error("no message on /clock yet; expected one, since use_sim_time is set")]
    NoClock,
    /// No action, or more than a chunk has.
    #[error("it has {0} actions; expected 1 to {MAX_CHUNK}")]
    Count(usize),
    /// An action that is not one of the action space.
    #[error("action {index}: {error}")]
    Action {
        /// Which action.
        index: usize,
        /// Its fault.
        error: ActionError,
    },
    /// A motion that is too large for one action.
    #[error(
        "action {index}: {name} is {value:.4} {unit}; at most {limit:.4} is allowed in {period_s} s"
    )]
    Bounds {
        /// Which action.
        index: usize,
        /// The dimension.
        name: String,
        /// Its value.
        value: f32,
        /// Greatest magnitude.
        limit: f64,
        /// Its unit.
        unit: String,
        /// How long the action takes \[s\].
        period_s: f64,
    },
    /// A position outside a joint's limits.
    #[error(
        "action {index}: {name} is to be at {place:.4}; expected {least} to {most} (joint_min, joint_max)"
    )]
    Place {
        /// Which action.
        index: usize,
        /// The joint.
        name: String,
        /// The position \[rad or m\].
        place: f64,
        /// Its least position \[rad or m\].
        least: f64,
        /// Its greatest position \[rad or m\].
        most: f64,
    },
    /// A position too far from the one before.
    #[error(
        "action {index}: {name} is to move by {way:.4}; at most {limit:.4} is allowed in {period_s} s"
    )]
    Way {
        /// Which action.
        index: usize,
        /// The joint.
        name: String,
        /// By how much \[rad or m\].
        way: f64,
        /// Greatest magnitude \[rad or m\].
        limit: f64,
        /// How long the action takes \[s\].
        period_s: f64,
    },
    /// An invalid opening of the gripper.
    #[error("action {index}: {name} is {value}; expected 0 (closed) to 1 (open)")]
    Gripper {
        /// Which action.
        index: usize,
        /// The dimension.
        name: String,
        /// Its value.
        value: f32,
    },
    /// Actions that follow too fast or too slowly.
    #[error("its period is {period_s} s; expected {least_s} to {most_s} s")]
    Period {
        /// The period \[s\].
        period_s: f64,
        /// Least \[s\].
        least_s: f64,
        /// Greatest \[s\].
        most_s: f64,
    },
    /// Motions in another frame.
    #[error("its frame is {actual:?}; expected base_frame, {expected:?}")]
    Frame {
        /// The parameter.
        expected: String,
        /// What came.
        actual: String,
    },
    /// A plan from before the planner's last reset.
    #[error("its epoch is {actual}; expected {newest} or later")]
    Epoch {
        /// The newest that was seen.
        newest: u64,
        /// What came.
        actual: u64,
    },
    /// A time with a `nanosec` of a second or more.
    #[error("the time of {what} has nanosec {nanosec}; expected less than 1000000000")]
    Stamp {
        /// The message or its part.
        what: &'static str,
        /// What came \[ns\].
        nanosec: u32,
    },
    /// It was made from a frame stamped in the future.
    #[error(transparent)]
    Future(#[from] FutureStamp),
    /// It was made from a frame before the end of the last freeze.
    #[error(
        "it was made from a frame {before_s:.2} s older than the first one after the camera's freeze"
    )]
    FrozenFrame {
        /// By how much \[s\].
        before_s: f64,
    },
    /// It is too old.
    #[error("it is {age_s:.2} s old; at most {most_s} s is allowed (max_age)")]
    Stale {
        /// Since its reception or, where it begins then, its stamp \[s\].
        age_s: f64,
        /// The parameter max_age \[s\].
        most_s: f64,
    },
    /// Its last action has ended.
    #[error("it came late: its last action was over {ago_s:.2} s ago")]
    Late {
        /// Since then \[s\].
        ago_s: f64,
    },
    /// It came so late that the arm would start and stop with each one.
    #[error(
        "it came {late_s:.2} s late, when {left_s:.2} s of it were left: send it earlier, send longer ones, or set begin to \
         reception"
    )]
    Behind {
        /// After its beginning \[s\].
        late_s: f64,
        /// Until its end \[s\].
        left_s: f64,
    },
    /// It begins far in the future: two clocks differ.
    #[error("it begins in {ahead_s:.2} s; at most {most_s} s is allowed: do the clocks agree?")]
    Early {
        /// Until then \[s\].
        ahead_s: f64,
        /// The parameter max_lead \[s\].
        most_s: f64,
    },
    /// A newer one was accepted earlier.
    #[error("its stamp is {before_s:.2} s before that of the newest one that was taken")]
    Older {
        /// By how much \[s\].
        before_s: f64,
    },
    /// The queue of offers that begin later is full.
    #[error("{0} others have yet to begin; no more are kept")]
    Full(usize),
    /// A condition of motion is missing.
    #[error(transparent)]
    Held(#[from] Hold),
    /// The model's predictions speak against it.
    #[error("vetoed: {0}")]
    Vetoed(#[from] Veto),
    /// Its assessment did not arrive.
    #[error("no assessment came within {waited_s:.2} s; expected one, since veto_required is set")]
    Unassessed {
        /// How long it waited \[s\].
        waited_s: f64,
    },
    /// The queue of offers that wait for assessments is full.
    #[error("{waiting} newer ones wait for their assessments; at most {waiting} are kept")]
    Crowded {
        /// How many are kept.
        waiting: usize,
    },
    /// It was dropped from the queue, because the node was armed, disarmed, stopped or reset.
    #[error("forgotten while it waited for its assessment")]
    Forgotten,
}

/// A stamp in nanoseconds.
///
/// # Errors
/// [`Refusal::Stamp`]: it is malformed.
pub(super) fn stamp_of(what: &'static str, stamp: Time) -> Result<i64, Refusal> {
    let nanosec = stamp.nanosec;
    stamp
        .checked_nanos()
        .map_err(|_| Refusal::Stamp { what, nanosec })
}

impl Refusal {
    /// A span in nanoseconds.
    pub(super) fn expect_span(what: &'static str, span: Duration) -> Result<i64, Self> {
        let nanosec = span.nanosec;
        span.checked_nanos()
            .map_err(|_| Self::Stamp { what, nanosec })
    }

    /// Whether the cause is lateness, which is reported once for all offers.
    pub fn is_late(&self) -> bool {
        matches!(self, Self::Late { .. } | Self::Behind { .. })
    }

    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::NotArmed => "not_armed",
            Self::Stopped => "stopped",
            Self::NoClock => "no_clock",
            Self::Count(_) => "action_count",
            Self::Action { error, .. } => match error {
                ActionError::NotFinite { .. } => "not_finite",
                ActionError::Implausible { .. } => "out_of_bounds",
                _ => "wrong_length",
            },
            Self::Bounds { .. } | Self::Place { .. } | Self::Way { .. } | Self::Gripper { .. } => {
                "out_of_bounds"
            }
            Self::Period { .. } => "period",
            Self::Frame { .. } => "wrong_frame",
            Self::Epoch { .. } => "old_epoch",
            Self::Stamp { .. } | Self::Future(_) => "bad_stamp",
            Self::FrozenFrame { .. } => "frozen_frame",
            Self::Stale { .. } => "stale",
            Self::Late { .. } | Self::Behind { .. } => "late",
            Self::Early { .. } => "early",
            Self::Older { .. } => "older",
            Self::Full(_) => "full",
            Self::Held(hold) => hold.reason(),
            Self::Vetoed(_) => "vetoed",
            Self::Unassessed { .. } | Self::Crowded { .. } => "unassessed",
            Self::Forgotten => "forgotten",
        }
    }
}
