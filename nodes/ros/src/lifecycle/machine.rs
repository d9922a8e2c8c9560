//! The state machine of a managed node: the allowed transitions. It knows neither the graph nor the node's work.

use super::{Outcome, State, Transition};

/// The state of a managed node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Machine {
    state: State,
}

/// A transition that is impossible in the node's state.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("in state {}: expected {expected}, got {asked}", .state.label())]
pub struct Refused {
    /// The node's state.
    pub state: State,
    /// The possible transitions.
    pub expected: String,
    /// What was requested.
    pub asked: String,
}

impl Default for Machine {
    fn default() -> Self {
        Self {
            state: State::Unconfigured,
        }
    }
}

impl Machine {
    /// Where the node is.
    #[must_use]
    pub const fn state(&self) -> State {
        self.state
    }

    /// The transitions from the node's state.
    pub fn available(&self) -> impl Iterator<Item = &'static Transition> + use<> {
        let state = self.state;
        Transition::GRAPH
            .iter()
            .filter(move |transition| transition.start == state)
    }

    /// Begins the requested transition: by its label, or by its id if the label is empty, as in rclcpp_lifecycle:
    /// clients that set only a label send the id 0.
    ///
    /// # Errors
    /// The transition is impossible in the node's state, or not public.
    pub fn begin(&mut self, id: u8, label: &str) -> Result<&'static Transition, Refused> {
        let is_asked = |transition: &&Transition| match label {
            "" => transition.id == id,
            label => transition.label == label,
        };
        let found = self
            .available()
            .filter(|transition| transition.is_public())
            .find(is_asked);
        let Some(transition) = found else {
            let names = self
                .available()
                .filter(|transition| transition.is_public())
                .map(|transition| format!("{} ({})", transition.label, transition.id));
            let mut expected = names.collect::<Vec<_>>().join(" or ");
            if expected.is_empty() {
                "no transition".clone_into(&mut expected);
            }
            return Err(Refused {
                state: self.state,
                expected,
                asked: format!("\"{label}\" ({id})"),
            });
        };
        self.state = transition.goal;
        Ok(transition)
    }

    /// Ends the transition under way; `None` without one.
    pub fn finish(&mut self, outcome: Outcome) -> Option<&'static Transition> {
        let transition = self
            .available()
            .find(|transition| !transition.is_public() && transition.label == outcome.label())?;
        self.state = transition.goal;
        Some(transition)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn walk(machine: &mut Machine, label: &str, outcome: Outcome) -> State {
        machine.begin(0, label).unwrap();
        machine.finish(outcome).unwrap();
        machine.state()
    }

    #[test]
    fn a_life_from_unconfigured_to_finalized() {
        let mut machine = Machine::default();
        for (label, state) in [
            ("configure", State::Inactive),
            ("activate", State::Active),
            ("deactivate", State::Inactive),
            ("cleanup", State::Unconfigured),
            ("configure", State::Inactive),
            ("activate", State::Active),
            ("shutdown", State::Finalized),
        ] {
            assert_eq!(walk(&mut machine, label, Outcome::Success), state);
        }
        assert_eq!(machine.available().count(), 0);
    }

    #[test]
    fn a_failure_leads_back_and_an_error_to_its_processing() {
        let mut machine = Machine::default();
        assert_eq!(
            walk(&mut machine, "configure", Outcome::Failure),
            State::Unconfigured
        );
        assert_eq!(
            walk(&mut machine, "configure", Outcome::Error),
            State::ErrorProcessing
        );
        machine.finish(Outcome::Success).unwrap();
        assert_eq!(machine.state(), State::Unconfigured);
    }

    #[test]
    fn shutdown_is_one_label_and_three_ids() {
        for (id, path) in [(5, vec![]), (6, vec![1]), (7, vec![1, 3])] {
            let mut machine = Machine::default();
            for step in path {
                machine.begin(step, "").unwrap();
                machine.finish(Outcome::Success).unwrap();
            }
            for other in [5, 6, 7].into_iter().filter(|other| *other != id) {
                assert!(machine.begin(other, "").is_err());
            }
            assert_eq!(machine.clone().begin(0, "shutdown").unwrap().id, id);
            assert_eq!(machine.begin(id, "").unwrap().goal, State::ShuttingDown);
        }
    }

    #[test]
    fn what_cannot_be_asked_is_refused_with_what_can() {
        let mut machine = Machine::default();
        assert_eq!(
            machine.begin(3, "").unwrap_err().to_string(),
            "in state unconfigured: expected configure (1) or shutdown (5), got \"\" (3)"
        );
        assert_eq!(machine.state(), State::Unconfigured);
        assert_eq!(machine.finish(Outcome::Success), None);
        machine.begin(1, "").unwrap();
        // The node's own transitions are not public.
        for (id, label) in [(10, ""), (0, "transition_success"), (1, "")] {
            let refused = machine.begin(id, label).unwrap_err();
            assert_eq!(refused.expected, "no transition");
        }
    }

    proptest! {
        /// For any requests, every step is one of the graph.
        #[test]
        fn every_step_is_in_the_graph(steps in prop::collection::vec((0u8..70, 0usize..4), 0..40)) {
            let mut machine = Machine::default();
            for (id, what) in steps {
                let before = machine.state();
                let outcome = [Outcome::Success, Outcome::Failure, Outcome::Error].get(what).copied();
                let taken = match outcome {
                    Some(outcome) => machine.finish(outcome),
                    None => machine.begin(id, "").ok(),
                };
                match taken {
                    Some(taken) => prop_assert_eq!((taken.start, taken.goal), (before, machine.state())),
                    None => prop_assert_eq!(machine.state(), before),
                }
            }
        }
    }
}
