//! Networks in training that compute on tensors.

use std::collections::BTreeSet;

use anyhow::Result;
use rand_chacha::ChaCha8Rng;

use crate::{
    arguments::RunArgs,
    fresh_weights::FreshWeights,
    optimiser::{Group, Parameter, ParameterValues, Variables},
    recipe::Recipe,
    run::{Learner, StepLoss},
    workers::{BatchLoss, Batches, Workers},
};

/// The variables of a network, and the threads that compute their gradients.
pub(crate) struct NetworkVariables {
    pub tensors: Variables,
    /// Groups of the optimiser, at most two.
    groups: Vec<Group>,
    /// Names of the second group.
    second: BTreeSet<String>,
    workers: Workers,
    /// Batches of step 0.
    batches: Batches,
}

impl NetworkVariables {
    /// In one group.
    pub fn new(tensors: Variables, recipe: &impl Recipe, run: &RunArgs) -> Result<Self> {
        Ok(Self {
            tensors,
            groups: vec![Group::default()],
            second: BTreeSet::new(),
            workers: Workers::new(run.threads()?)?,
            batches: recipe.course().batches(),
        })
    }

    /// Weights after their network is loaded; fine-tuned ones have a learning rate of their own.
    pub fn fresh(fresh: FreshWeights, recipe: &impl Recipe, run: &RunArgs) -> Result<Self> {
        let (tensors, old) = fresh.into_variables();
        Ok(Self::new(tensors, recipe, run)?.in_groups(run.groups(), old))
    }

    /// The variables named `second` are in the second group, all others in the first.
    pub fn in_groups(self, groups: Vec<Group>, second: BTreeSet<String>) -> Self {
        Self {
            groups,
            second,
            ..self
        }
    }
}

/// A [`Learner`] whose parameters are variables.
pub(crate) trait NetworkLearner: Sync {
    fn variables(&self) -> &NetworkVariables;

    /// Loss of a small batch of `step`, with samples drawn by `rng`.
    fn batch_loss(&self, step: u64, rng: &mut ChaCha8Rng) -> Result<BatchLoss>;

    /// Follows assigned variables, for networks that do not compute on them directly.
    fn follow(&mut self) -> Result<()> {
        Ok(())
    }

    /// See [`Learner::assign_averaged`].
    fn follow_averaged(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
    ) -> Result<()> {
        let _ = averaged;
        Ok(())
    }
}

impl<T: NetworkLearner> Learner for T {
    fn parameters(&self) -> Result<Vec<Parameter>> {
        let NetworkVariables {
            tensors, second, ..
        } = self.variables();
        Ok(tensors.parameters(|name| usize::from(second.contains(name)))?)
    }

    fn groups(&self) -> Vec<Group> {
        self.variables().groups.clone()
    }

    fn step(&mut self, step: u64) -> Result<StepLoss> {
        let variables = self.variables();
        let batches = Batches {
            step,
            ..variables.batches
        };
        let loss = |rng: &mut ChaCha8Rng| self.batch_loss(step, rng);
        variables.workers.step(&variables.tensors, batches, &loss)
    }

    fn assign(&mut self, weights: &mut dyn Iterator<Item = ParameterValues<'_>>) -> Result<()> {
        self.variables().tensors.assign(weights)?;
        self.follow()
    }

    fn assign_averaged(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
    ) -> Result<()> {
        self.follow_averaged(averaged)
    }
}
