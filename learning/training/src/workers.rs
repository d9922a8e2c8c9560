//! Worker threads for the small batches of a step.

use std::{
    ops::Range,
    sync::atomic::{AtomicUsize, Ordering},
};

use anyhow::{Context as _, Result, anyhow, ensure};
use candle_core::{Tensor, backprop::GradStore};
use rand_chacha::ChaCha8Rng;
use rayon::{ThreadPool, ThreadPoolBuilder};
use wm_model::transition::WeightGradients;

use crate::{
    gradient_tree::GradientTree,
    optimiser::{Variables, step_rng},
    run::StepLoss,
};

/// Loss of a small batch.
pub struct BatchLoss {
    /// The minimised value, a scalar.
    pub loss: Tensor,
    /// Notable parts by name, in the same order for all batches.
    pub parts: Vec<(&'static str, f64)>,
    /// Gradients outside the loss's graph.
    pub gradients: WeightGradients,
}

impl From<Tensor> for BatchLoss {
    fn from(loss: Tensor) -> Self {
        Self {
            loss,
            parts: Vec::new(),
            gradients: WeightGradients::default(),
        }
    }
}

/// Computes the loss of a small batch, with samples drawn by the generator.
pub type BatchFn<'a> = dyn Fn(&mut ChaCha8Rng) -> Result<BatchLoss> + Sync + 'a;

/// Threads that each compute whole small batches.
///
/// Operations split over threads wait for each other at every layer; whole batches in parallel do not.
pub struct Workers {
    /// One single-threaded pool per worker, so that operations do not spread.
    pools: Vec<ThreadPool>,
}

/// Batches of a step, with the seed of their samples.
#[derive(Clone, Copy, Debug)]
pub struct Batches {
    /// Number of small batches per step.
    pub count: usize,
    /// Seed.
    pub seed: u64,
    /// Index of the step.
    pub step: u64,
}

impl Batches {
    /// The batches of step `step`.
    pub fn at(self, step: u64) -> Self {
        Self { step, ..self }
    }

    /// Mean loss of a tree of sums.
    ///
    /// # Errors
    /// If a batch is missing, or there are none.
    pub fn mean(self, tree: GradientTree) -> Result<StepLoss> {
        let mut mean = tree.into_root().context("a step without all its batches")?;
        for (_, part) in &mut mean.parts {
            *part /= self.count as f64;
        }
        Ok(mean)
    }
}

impl Workers {
    /// Starts `threads` threads.
    ///
    /// # Errors
    /// If it is 0, or they cannot be started.
    pub fn new(threads: usize) -> Result<Self> {
        ensure!(threads > 0, "0 threads, expected at least 1");
        let pools = (0..threads)
            .map(|_| ThreadPoolBuilder::new().num_threads(1).build())
            .collect::<Result<_, _>>()?;
        Ok(Self { pools })
    }

    /// Mean loss over one step's batches, and its gradient by `variables`. `loss` computes one batch from its own
    /// random numbers, so the result does not depend on the number of threads.
    ///
    /// # Errors
    /// If `loss` fails, or a variable has no gradient.
    pub fn step(
        &self,
        variables: &Variables,
        batches: Batches,
        loss: &BatchFn<'_>,
    ) -> Result<StepLoss> {
        let tree = GradientTree::new(batches.count);
        self.add(&tree, (variables, batches), 0..batches.count, loss)?;
        batches.mean(tree)
    }

    /// Adds the batches `part` of a step to the tree of all its batches.
    ///
    /// # Errors
    /// Those of [`step`](Self::step).
    pub fn add(
        &self,
        tree: &GradientTree,
        (variables, batches): (&Variables, Batches),
        part: Range<usize>,
        loss: &BatchFn<'_>,
    ) -> Result<()> {
        let Batches { count, seed, step } = batches;
        let next = AtomicUsize::new(part.start);
        let batch = |index: usize| -> Result<StepLoss> {
            // An independent stream per batch, whichever worker takes it.
            let mut rng = step_rng(seed, step * count as u64 + index as u64);
            let found = loss(&mut rng)?;
            let mean = (found.loss / count as f64)?;
            let gradients: GradStore = mean.backward()?;
            Ok(StepLoss {
                gradient: variables.gradients(&gradients, &found.gradients)?,
                loss: mean.to_scalar()?,
                parts: found.parts,
            })
        };
        let work = || -> Result<()> {
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= part.end {
                    return Ok(());
                }
                let found =
                    batch(index).inspect_err(|_| next.store(part.end, Ordering::Relaxed))?;
                tree.add_leaf(index, found);
            }
        };
        std::thread::scope(|scope| {
            let running: Vec<_> = self
                .pools
                .iter()
                .map(|pool| scope.spawn(|| pool.install(work)))
                .collect();
            let ends = running.into_iter().map(|worker| {
                let ended = worker.join();
                ended.map_err(|_| anyhow!("a training thread panicked"))?
            });
            // All of them, also after an error.
            ends.fold(Ok(()), Result::and)
        })
    }
}
