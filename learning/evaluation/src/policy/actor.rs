//! A policy's actions, model step by model step.

use std::collections::VecDeque;

use anyhow::Result;
use wm_motion::actions::{ActionEncoding, ActionSpace};

use super::{
    protocol::{Request, actions},
    setup::Policy,
};

/// A policy with its remaining actions.
pub(crate) struct Actor<'a> {
    policy: &'a Policy,
    space: &'a ActionSpace,
    /// Actions per model step.
    skip: usize,
    /// Whole model steps of actions.
    queue: VecDeque<Vec<f32>>,
    /// The last action.
    last: Vec<f32>,
}

impl<'a> Actor<'a> {
    /// Starts after the action `last`, with the actions that were recorded after it.
    pub(crate) fn new(
        policy: &'a Policy,
        encoding: &'a ActionEncoding,
        last: &[f32],
        recorded: &[Vec<f32>],
    ) -> Self {
        let mut actor = Self {
            policy,
            space: encoding.space(),
            skip: encoding.frame_skip(),
            queue: VecDeque::new(),
            last: last.to_vec(),
        };
        if matches!(policy, Policy::Recorded) {
            actor.queue.extend(recorded.iter().cloned());
            let end = still(recorded.last().map_or(last, Vec::as_slice), actor.space);
            actor.fill(&end);
        }
        actor
    }

    /// Fills the last model step with `action`.
    fn fill(&mut self, action: &[f32]) {
        let whole = self.queue.len().next_multiple_of(self.skip);
        self.queue.resize(whole, action.to_vec());
    }

    /// Whether it needs new actions.
    pub(crate) fn needs_actions(&self) -> bool {
        self.queue.is_empty() && matches!(self.policy, Policy::Command(_))
    }

    /// Asks the program for actions.
    ///
    /// # Errors
    /// If it fails, or its answer is invalid.
    pub(crate) fn request(&mut self, request: &Request<'_>) -> Result<()> {
        let Policy::Command(process) = self.policy else {
            return Ok(());
        };
        let line = process.ask(request)?;
        let answered = actions(&line, self.space)?;
        let held = answered.last().cloned();
        self.queue.extend(answered);
        if let Some(held) = held {
            self.fill(&held);
        }
        Ok(())
    }

    /// Actions of this model step, and of the next one if known.
    pub(crate) fn step(&mut self) -> (Vec<Vec<f32>>, Option<Vec<Vec<f32>>>) {
        let count = self.skip.min(self.queue.len());
        let mut taken: Vec<Vec<f32>> = self.queue.drain(..count).collect();
        if let Some(last) = taken.last() {
            self.last.clone_from(last);
        }
        let rest = still(&self.last, self.space);
        taken.resize(self.skip, rest.clone());
        let next: Vec<Vec<f32>> = self.queue.iter().take(self.skip).cloned().collect();
        let next = match self.policy {
            _ if !next.is_empty() => Some(next),
            Policy::Command(_) => None,
            Policy::Recorded | Policy::Still => Some(vec![rest; self.skip]),
        };
        (taken, next)
    }
}

/// No motion after an action: changes and velocities are zero, states stay.
pub(super) fn still(last: &[f32], space: &ActionSpace) -> Vec<f32> {
    let values = space.dimensions().iter().zip(last);
    values
        .map(|(dimension, last)| {
            if dimension.kind.is_motion() {
                0.0
            } else {
                *last
            }
        })
        .collect()
}
