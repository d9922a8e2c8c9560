//! The services that report states and transitions. They run on the receiving thread, so they also answer during a
//! transition.

use super::{Machine, State, Transition};
use crate::{Error, Node};
use std::sync::{Arc, Mutex, PoisonError};
use wm_msgs::lifecycle_msgs::{
    GetAvailableStates, GetAvailableStatesResponse, GetAvailableTransitions,
    GetAvailableTransitionsResponse, GetState, GetStateResponse,
};

/// Serves them until the node ends.
pub(super) fn serve(node: &Node, machine: &Arc<Mutex<Machine>>) -> Result<(), Error> {
    let now = Arc::clone(machine);
    node.serve::<GetState>("~/get_state", move |_| GetStateResponse {
        current_state: now
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .state()
            .message(),
    })?;
    node.serve::<GetAvailableStates>("~/get_available_states", |_| GetAvailableStatesResponse {
        available_states: State::ALL.map(State::message).to_vec(),
    })?;
    let now = Arc::clone(machine);
    node.serve::<GetAvailableTransitions>("~/get_available_transitions", move |_| {
        let machine = now.lock().unwrap_or_else(PoisonError::into_inner);
        GetAvailableTransitionsResponse {
            available_transitions: machine.available().map(Transition::description).collect(),
        }
    })?;
    node.serve::<GetAvailableTransitions>("~/get_transition_graph", |_| {
        GetAvailableTransitionsResponse {
            available_transitions: Transition::GRAPH
                .iter()
                .map(Transition::description)
                .collect(),
        }
    })
}
