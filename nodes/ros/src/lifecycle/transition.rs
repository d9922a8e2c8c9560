use super::State;
use wm_msgs::lifecycle_msgs;

/// A way from one state to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Transition {
    /// The number in messages (`lifecycle_msgs/msg/Transition`). Those below 10 are for others to ask for; the node
    /// makes the rest itself, when it is done with what a transition asks of it.
    pub id: u8,
    /// The name in messages.
    pub label: &'static str,
    /// Where it begins.
    pub start: State,
    /// Where it leads.
    pub goal: State,
}

/// How what a transition asks of the node went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// As asked.
    Success,
    /// Not as asked; the node is as it was before.
    Failure,
    /// Not as asked, and the node is not as it was.
    Error,
}

impl Outcome {
    /// The label of the transitions that it leads to.
    pub(super) const fn label(self) -> &'static str {
        match self {
            Self::Success => "transition_success",
            Self::Failure => "transition_failure",
            Self::Error => "transition_error",
        }
    }
}

const fn to(id: u8, label: &'static str, start: State, goal: State) -> Transition {
    Transition {
        id,
        label,
        start,
        goal,
    }
}

const SUCCESS: &str = Outcome::Success.label();
const FAILURE: &str = Outcome::Failure.label();
const ERROR: &str = Outcome::Error.label();

impl Transition {
    /// All that there are: rcl_lifecycle's default state machine, in its order. A test holds it against rclpy's own.
    pub const GRAPH: [Self; 25] = {
        use State::{
            Activating, Active, CleaningUp, Configuring, Deactivating, ErrorProcessing, Finalized,
            Inactive, ShuttingDown, Unconfigured,
        };
        [
            to(1, "configure", Unconfigured, Configuring),
            to(10, SUCCESS, Configuring, Inactive),
            to(11, FAILURE, Configuring, Unconfigured),
            to(12, ERROR, Configuring, ErrorProcessing),
            to(2, "cleanup", Inactive, CleaningUp),
            to(20, SUCCESS, CleaningUp, Unconfigured),
            to(21, FAILURE, CleaningUp, Inactive),
            to(22, ERROR, CleaningUp, ErrorProcessing),
            to(3, "activate", Inactive, Activating),
            to(30, SUCCESS, Activating, Active),
            to(31, FAILURE, Activating, Inactive),
            to(32, ERROR, Activating, ErrorProcessing),
            to(4, "deactivate", Active, Deactivating),
            to(40, SUCCESS, Deactivating, Inactive),
            to(41, FAILURE, Deactivating, Active),
            to(42, ERROR, Deactivating, ErrorProcessing),
            to(5, "shutdown", Unconfigured, ShuttingDown),
            to(6, "shutdown", Inactive, ShuttingDown),
            to(7, "shutdown", Active, ShuttingDown),
            to(50, SUCCESS, ShuttingDown, Finalized),
            to(51, FAILURE, ShuttingDown, Finalized),
            to(52, ERROR, ShuttingDown, ErrorProcessing),
            to(60, SUCCESS, ErrorProcessing, Unconfigured),
            to(61, FAILURE, ErrorProcessing, Finalized),
            to(62, ERROR, ErrorProcessing, Finalized),
        ]
    };

    /// Whether others may ask for it.
    #[must_use]
    pub const fn is_public(&self) -> bool {
        self.id < 10
    }

    pub(super) fn message(&self) -> lifecycle_msgs::Transition {
        lifecycle_msgs::Transition {
            id: self.id,
            label: self.label.to_owned(),
        }
    }

    pub(super) fn description(&self) -> lifecycle_msgs::TransitionDescription {
        lifecycle_msgs::TransitionDescription {
            transition: self.message(),
            start_state: self.start.message(),
            goal_state: self.goal.message(),
        }
    }
}
