//! Package `action_msgs`: what the actions of all types have in common.

use super::{builtin_interfaces::Time, unique_identifier_msgs::UUID};
use serde::{Deserialize, Serialize};

/// A goal that was accepted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GoalInfo {
    /// Which one.
    pub goal_id: UUID,
    /// When it was accepted.
    pub stamp: Time,
}

/// How far a goal is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GoalStatus {
    /// Which one.
    pub goal_info: GoalInfo,
    /// One of the constants.
    pub status: i8,
}

impl GoalStatus {
    /// Not told, or not known (any more).
    pub const STATUS_UNKNOWN: i8 = 0;
    /// It waits for its execution.
    pub const STATUS_ACCEPTED: i8 = 1;
    /// It is being executed.
    pub const STATUS_EXECUTING: i8 = 2;
    /// Its cancellation was requested and accepted.
    pub const STATUS_CANCELING: i8 = 3;
    /// It was achieved.
    pub const STATUS_SUCCEEDED: i8 = 4;
    /// It was ended because a client requested it.
    pub const STATUS_CANCELED: i8 = 5;
    /// The server ended it by itself.
    pub const STATUS_ABORTED: i8 = 6;
}

/// How far the goals of a server are.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GoalStatusArray {
    /// One for each goal that it knows.
    pub status_list: Vec<GoalStatus>,
}

/// Service: cancel goals.
#[derive(Clone, Copy, Debug)]
pub struct CancelGoal;

/// What a client of [`CancelGoal`] sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CancelGoalRequest {
    /// Which goals: the one with this id, and those that were accepted at this time or before; with neither (all zero),
    /// all of them.
    pub goal_info: GoalInfo,
}

/// What a server of [`CancelGoal`] answers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CancelGoalResponse {
    /// One of the constants.
    pub return_code: i8,
    /// The goals that are being canceled now.
    pub goals_canceling: Vec<GoalInfo>,
}

impl CancelGoalResponse {
    /// No error.
    pub const ERROR_NONE: i8 = 0;
    /// The server refused.
    pub const ERROR_REJECTED: i8 = 1;
    /// There is no goal with this id.
    pub const ERROR_UNKNOWN_GOAL_ID: i8 = 2;
    /// The goal has ended already.
    pub const ERROR_GOAL_TERMINATED: i8 = 3;
}

message!(
    GoalInfo,
    "action_msgs",
    "unique_identifier_msgs/UUID goal_id\nbuiltin_interfaces/Time stamp\n",
    [UUID, Time]
);
message!(
    GoalStatus,
    "action_msgs",
    "int8 STATUS_UNKNOWN=0\nint8 STATUS_ACCEPTED=1\nint8 STATUS_EXECUTING=2\nint8 STATUS_CANCELING=3\n\
     int8 STATUS_SUCCEEDED=4\nint8 STATUS_CANCELED=5\nint8 STATUS_ABORTED=6\nGoalInfo goal_info\nint8 status\n",
    [GoalInfo]
);
message!(
    GoalStatusArray,
    "action_msgs",
    "GoalStatus[] status_list\n",
    [GoalStatus]
);
service!(
    CancelGoal,
    "action_msgs",
    "GoalInfo goal_info\n---\nint8 ERROR_NONE=0\nint8 ERROR_REJECTED=1\nint8 ERROR_UNKNOWN_GOAL_ID=2\n\
     int8 ERROR_GOAL_TERMINATED=3\nint8 return_code\nGoalInfo[] goals_canceling\n",
    CancelGoalRequest,
    CancelGoalResponse,
    [GoalInfo]
);
