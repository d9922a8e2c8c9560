//! Actions: goals that take a while, with feedback, a result, and a way to cancel them
//! (<https://design.ros2.org/articles/actions.html>).
//!
//! On the wire an action `plan` is three services and two topics: `plan/_action/send_goal`, `plan/_action/cancel_goal`,
//! `plan/_action/get_result`, `plan/_action/feedback`, and `plan/_action/status`, which is latched. [`goals`] has the
//! rules for goals, without the wire; [`server`] and [`client`] are the two ends.
//!
//! The node accepts, executes and ends goals. The server answers requests to cancel and for results by itself. It
//! accepts every request to cancel a goal: the node is notified, and ends the goal when it can.

pub(crate) mod client;
mod goals;
mod id;
pub(crate) mod server;
mod status;

pub use client::{ActionClient, ClientGoal};
pub use id::GoalId;
pub use server::{ActionServer, GoalRequest, ServerGoal};
pub use status::GoalStatus;

use crate::Qos;

/// As in rclcpp: its defaults for topics, and the last status for late joiners.
pub(crate) const FEEDBACK_QOS: Qos = Qos::reliable(10);
pub(crate) const STATUS_QOS: Qos = Qos::latched(1);

/// The name of a part of an action; `action` is resolved.
pub(crate) fn part(action: &str, part: &str) -> String {
    format!("{action}/_action/{part}")
}
