use super::State;
use wm_msgs::lifecycle_msgs;

/// A transition from one state to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Transition {
    /// The number in messages (`lifecycle_msgs/msg/Transition`). Those below 10 are public; the node makes the others
    /// itself, when the work of a transition has ended.
    pub id: u8,
    /// The name in messages.
    pub label: &'static str,
    /// The state in which it begins.
    pub start: State,
    /// The state in which it ends.
    pub goal: State,
}

/// The outcome of the node's work in a transition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// Done.
    Success,
    /// Not done; the node is unchanged.
    Failure,
    /// Failed, with the node in an unknown state.
    Error,
}

impl Outcome {
    /// The label of the resulting transitions.
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
    /// All transitions: rcl_lifecycle's default state machine, in its order. A test compares it with rclpy's.
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

    /// Whether clients may request it.
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
