//! Networks in training that compute on tensors.

use std::{collections::BTreeSet, ops::Range};

use anyhow::Result;
use rand_chacha::ChaCha8Rng;

use crate::{
    arguments::RunArgs,
    fresh_weights::FreshWeights,
    gradient_tree::{GradientTree, Node},
    optimiser::{Group, Parameter, ParameterValues, Variables},
    processes::{Computation, Coordinator},
    recipe::Recipe,
    run::{Learner, StepLoss, Stop},
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
    /// Shares the batches with other processes.
    pub coordinator: Option<Coordinator>,
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
            coordinator: None,
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

    fn begin(&mut self, stop: &Stop) {
        if let Some(coordinator) = &self.variables().coordinator {
            coordinator.wait_for_workers(stop);
        }
    }

    fn step(&mut self, step: u64) -> Result<StepLoss> {
        let variables = self.variables();
        let batches = variables.batches.at(step);
        let Some(coordinator) = &variables.coordinator else {
            let loss = |rng: &mut ChaCha8Rng| self.batch_loss(step, rng);
            return variables.workers.step(&variables.tensors, batches, &loss);
        };
        let weights = || Ok(variables.tensors.values()?);
        let compute = |tree: &GradientTree, part| add(self, tree, step, part);
        batches.mean(coordinator.step((step, batches.count), weights, &compute)?)
    }

    fn take_notices(&mut self) -> Vec<String> {
        let coordinator = self.variables().coordinator.as_ref();
        coordinator.map_or_else(Vec::new, Coordinator::take_notices)
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

/// Adds the batches `part` of a step to their tree.
fn add(
    learner: &(impl NetworkLearner + ?Sized),
    tree: &GradientTree,
    step: u64,
    part: Range<usize>,
) -> Result<()> {
    let variables = learner.variables();
    let batches = variables.batches.at(step);
    let loss = |rng: &mut ChaCha8Rng| learner.batch_loss(step, rng);
    let workers = &variables.workers;
    workers.add(tree, (&variables.tensors, batches), part, &loss)
}

/// The share of a worker process in the training of a network.
pub(crate) struct Share<T>(pub T);

impl<T: NetworkLearner> Computation for Share<T> {
    fn sizes(&self) -> Vec<usize> {
        self.0.variables().tensors.sizes()
    }

    fn count(&self) -> usize {
        self.0.variables().batches.count
    }

    fn sums(
        &mut self,
        step: u64,
        batches: Range<usize>,
        weights: &[Vec<f32>],
    ) -> Result<Vec<Node>> {
        let tree = GradientTree::new(self.count());
        self.0.variables().tensors.assign_values(weights)?;
        self.0.follow()?;
        add(&self.0, &tree, step, batches)?;
        Ok(tree.into_nodes())
    }
}
