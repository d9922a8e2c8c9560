//! Package `lifecycle_msgs`: states and transitions of managed nodes, and the services that ask for them.

use serde::{Deserialize, Serialize};

/// A state of a managed node.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct State {
    /// One of the constants of the definition: 1 to 4 primary states, 10 to 15 transition states.
    pub id: u8,
    /// Its name, for example `inactive`.
    pub label: String,
}

/// A way from one state to another.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transition {
    /// One of the constants of the definition.
    pub id: u8,
    /// Its name, for example `configure`.
    pub label: String,
}

/// A transition with its two ends.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransitionDescription {
    /// The transition.
    pub transition: Transition,
    /// Where it begins.
    pub start_state: State,
    /// Where it leads.
    pub goal_state: State,
}

/// A transition that a node has made.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransitionEvent {
    /// When \[ns since the epoch\].
    pub timestamp: u64,
    /// The transition.
    pub transition: Transition,
    /// Where it began.
    pub start_state: State,
    /// Where it led.
    pub goal_state: State,
}

/// What a request without fields is on the wire: IDL has no empty structs, so rosidl gives them one member.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EmptyRequest {
    /// Of no meaning.
    pub structure_needs_at_least_one_member: u8,
}

/// Service: make a transition.
#[derive(Clone, Copy, Debug)]
pub struct ChangeState;

/// What a client of [`ChangeState`] sends.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChangeStateRequest {
    /// The transition, by its label or, where that is empty, by its id.
    pub transition: Transition,
}

/// What a server of [`ChangeState`] answers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChangeStateResponse {
    /// Whether it was made, to its end.
    pub success: bool,
}

/// Service: the state that the node is in.
#[derive(Clone, Copy, Debug)]
pub struct GetState;

/// What a server of [`GetState`] answers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetStateResponse {
    /// The state.
    pub current_state: State,
}

/// Service: the states that there are.
#[derive(Clone, Copy, Debug)]
pub struct GetAvailableStates;

/// What a server of [`GetAvailableStates`] answers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetAvailableStatesResponse {
    /// The states.
    pub available_states: Vec<State>,
}

/// Service: the transitions that can be made now; as `get_transition_graph`, all that there are.
#[derive(Clone, Copy, Debug)]
pub struct GetAvailableTransitions;

/// What a server of [`GetAvailableTransitions`] answers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetAvailableTransitionsResponse {
    /// The transitions.
    pub available_transitions: Vec<TransitionDescription>,
}

message!(
    State,
    "lifecycle_msgs",
    "uint8 PRIMARY_STATE_UNKNOWN=0\nuint8 PRIMARY_STATE_UNCONFIGURED=1\nuint8 PRIMARY_STATE_INACTIVE=2\n\
     uint8 PRIMARY_STATE_ACTIVE=3\nuint8 PRIMARY_STATE_FINALIZED=4\nuint8 TRANSITION_STATE_CONFIGURING=10\n\
     uint8 TRANSITION_STATE_CLEANINGUP=11\nuint8 TRANSITION_STATE_SHUTTINGDOWN=12\n\
     uint8 TRANSITION_STATE_ACTIVATING=13\nuint8 TRANSITION_STATE_DEACTIVATING=14\n\
     uint8 TRANSITION_STATE_ERRORPROCESSING=15\nuint8 id\nstring label\n",
    []
);
message!(
    Transition,
    "lifecycle_msgs",
    "uint8 TRANSITION_CREATE=0\nuint8 TRANSITION_CONFIGURE=1\nuint8 TRANSITION_CLEANUP=2\n\
     uint8 TRANSITION_ACTIVATE=3\nuint8 TRANSITION_DEACTIVATE=4\nuint8 TRANSITION_UNCONFIGURED_SHUTDOWN=5\n\
     uint8 TRANSITION_INACTIVE_SHUTDOWN=6\nuint8 TRANSITION_ACTIVE_SHUTDOWN=7\nuint8 TRANSITION_DESTROY=8\n\
     uint8 TRANSITION_ON_CONFIGURE_SUCCESS=10\nuint8 TRANSITION_ON_CONFIGURE_FAILURE=11\n\
     uint8 TRANSITION_ON_CONFIGURE_ERROR=12\nuint8 TRANSITION_ON_CLEANUP_SUCCESS=20\n\
     uint8 TRANSITION_ON_CLEANUP_FAILURE=21\nuint8 TRANSITION_ON_CLEANUP_ERROR=22\n\
     uint8 TRANSITION_ON_ACTIVATE_SUCCESS=30\nuint8 TRANSITION_ON_ACTIVATE_FAILURE=31\n\
     uint8 TRANSITION_ON_ACTIVATE_ERROR=32\nuint8 TRANSITION_ON_DEACTIVATE_SUCCESS=40\n\
     uint8 TRANSITION_ON_DEACTIVATE_FAILURE=41\nuint8 TRANSITION_ON_DEACTIVATE_ERROR=42\n\
     uint8 TRANSITION_ON_SHUTDOWN_SUCCESS=50\nuint8 TRANSITION_ON_SHUTDOWN_FAILURE=51\n\
     uint8 TRANSITION_ON_SHUTDOWN_ERROR=52\nuint8 TRANSITION_ON_ERROR_SUCCESS=60\n\
     uint8 TRANSITION_ON_ERROR_FAILURE=61\nuint8 TRANSITION_ON_ERROR_ERROR=62\n\
     uint8 TRANSITION_CALLBACK_SUCCESS=97\nuint8 TRANSITION_CALLBACK_FAILURE=98\n\
     uint8 TRANSITION_CALLBACK_ERROR=99\nuint8 id\nstring label\n",
    []
);
message!(
    TransitionDescription,
    "lifecycle_msgs",
    "Transition transition\nState start_state\nState goal_state\n",
    [Transition, State]
);
message!(
    TransitionEvent,
    "lifecycle_msgs",
    "uint64 timestamp\nTransition transition\nState start_state\nState goal_state\n",
    [Transition, State]
);
service!(
    ChangeState,
    "lifecycle_msgs",
    "Transition transition\n---\nbool success\n",
    ChangeStateRequest,
    ChangeStateResponse,
    [Transition]
);
service!(
    GetState,
    "lifecycle_msgs",
    "---\nState current_state\n",
    EmptyRequest,
    GetStateResponse,
    [State]
);
service!(
    GetAvailableStates,
    "lifecycle_msgs",
    "---\nState[] available_states\n",
    EmptyRequest,
    GetAvailableStatesResponse,
    [State]
);
service!(
    GetAvailableTransitions,
    "lifecycle_msgs",
    "---\nTransitionDescription[] available_transitions\n",
    EmptyRequest,
    GetAvailableTransitionsResponse,
    [TransitionDescription]
);
