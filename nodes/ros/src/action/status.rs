use std::fmt;
use wm_msgs::action_msgs;

/// The status of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalStatus {
    /// Accepted; it waits for its execution.
    Accepted,
    /// Under execution.
    Executing,
    /// A client requested its cancellation, and the server has not ended it yet.
    Canceling,
    /// Ended: achieved.
    Succeeded,
    /// Ended at the request of a client.
    Canceled,
    /// Ended by the server without success.
    Aborted,
}

impl GoalStatus {
    const ALL: [Self; 6] = [
        Self::Accepted,
        Self::Executing,
        Self::Canceling,
        Self::Succeeded,
        Self::Canceled,
        Self::Aborted,
    ];

    /// The number of `action_msgs/msg/GoalStatus`.
    #[must_use]
    pub const fn number(self) -> i8 {
        match self {
            Self::Accepted => action_msgs::GoalStatus::STATUS_ACCEPTED,
            Self::Executing => action_msgs::GoalStatus::STATUS_EXECUTING,
            Self::Canceling => action_msgs::GoalStatus::STATUS_CANCELING,
            Self::Succeeded => action_msgs::GoalStatus::STATUS_SUCCEEDED,
            Self::Canceled => action_msgs::GoalStatus::STATUS_CANCELED,
            Self::Aborted => action_msgs::GoalStatus::STATUS_ABORTED,
        }
    }

    /// `None` for an unknown number.
    #[must_use]
    pub fn from_number(number: i8) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|status| status.number() == number)
    }

    /// Whether the goal has ended.
    #[must_use]
    pub const fn is_end(self) -> bool {
        matches!(self, Self::Succeeded | Self::Canceled | Self::Aborted)
    }
}

impl fmt::Display for GoalStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Accepted => "accepted",
            Self::Executing => "executing",
            Self::Canceling => "canceling",
            Self::Succeeded => "succeeded",
            Self::Canceled => "canceled",
            Self::Aborted => "aborted",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_back_and_unknown_is_none() {
        for status in GoalStatus::ALL {
            assert_eq!(GoalStatus::from_number(status.number()), Some(status));
        }
        for number in [action_msgs::GoalStatus::STATUS_UNKNOWN, 7, -1] {
            assert_eq!(GoalStatus::from_number(number), None);
        }
    }
}
