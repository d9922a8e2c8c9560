//! What rosidl makes of every action type beside its goal, result and feedback: the two halves of the services
//! `NAME/_action/send_goal` and `NAME/_action/get_result`, and the message of the topic `NAME/_action/feedback`
//! (<https://design.ros2.org/articles/actions.html>).

use crate::{builtin_interfaces::Time, unique_identifier_msgs::UUID};
use serde::{Deserialize, Serialize};

/// `TYPE_SendGoal_Request`: what a client requests.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SendGoalRequest<Goal> {
    /// The goal's identity, which the client chooses.
    pub goal_id: UUID,
    /// The goal.
    pub goal: Goal,
}

/// `TYPE_SendGoal_Response`: whether the server takes it on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SendGoalResponse {
    /// Whether it does.
    pub accepted: bool,
    /// When the goal was accepted.
    pub stamp: Time,
}

/// `TYPE_GetResult_Request`: answered when the goal has ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetResultRequest {
    /// Which goal.
    pub goal_id: UUID,
}

/// `TYPE_GetResult_Response`: how a goal ended.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GetResultResponse<Result> {
    /// One of the constants of [`GoalStatus`](crate::action_msgs::GoalStatus); unknown, where the server does not know
    /// the goal.
    pub status: i8,
    /// What it came to.
    pub result: Result,
}

/// `TYPE_FeedbackMessage`: news of a goal that is being executed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FeedbackMessage<Feedback> {
    /// Which goal.
    pub goal_id: UUID,
    /// The news.
    pub feedback: Feedback,
}
