//! The types that rosidl adds to every action type: the two halves of the services `NAME/_action/send_goal` and
//! `NAME/_action/get_result`, and the message of the topic `NAME/_action/feedback`
//! (<https://design.ros2.org/articles/actions.html>).

use crate::{builtin_interfaces::Time, unique_identifier_msgs::UUID};
use serde::{Deserialize, Serialize};

/// `TYPE_SendGoal_Request`: a client requests a goal.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SendGoalRequest<Goal> {
    /// Identity of the goal, chosen by the client.
    pub goal_id: UUID,
    /// The goal.
    pub goal: Goal,
}

/// `TYPE_SendGoal_Response`: the server accepts or rejects a goal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SendGoalResponse {
    /// Whether the goal is accepted.
    pub accepted: bool,
    /// When the goal was accepted.
    pub stamp: Time,
}

/// `TYPE_GetResult_Request`: the server responds when the goal has ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetResultRequest {
    /// Identity of the goal.
    pub goal_id: UUID,
}

/// `TYPE_GetResult_Response`: the end of a goal.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GetResultResponse<Result> {
    /// One of the constants of [`GoalStatus`](crate::action_msgs::GoalStatus); unknown if the server does not know the
    /// goal.
    pub status: i8,
    /// The result.
    pub result: Result,
}

/// `TYPE_FeedbackMessage`: the progress of a goal.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FeedbackMessage<Feedback> {
    /// Identity of the goal.
    pub goal_id: UUID,
    /// The progress.
    pub feedback: Feedback,
}
