//! Worker threads for the small batches of a step.

use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context as _, Result, anyhow, ensure};
use candle_core::{Tensor, backprop::GradStore};
use rand_chacha::ChaCha8Rng;
use rayon::{ThreadPool, ThreadPoolBuilder, prelude::*};
use wm_model::transition::WeightGradients;

use crate::{
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
        loss: &(dyn Fn(&mut ChaCha8Rng) -> Result<BatchLoss> + Sync),
    ) -> Result<StepLoss> {
        let Batches { count, seed, step } = batches;
        let next = AtomicUsize::new(0);
        let batch = |index: usize| -> Result<(BatchLoss, GradStore)> {
            // An independent stream per batch, whichever worker takes it.
            let mut rng = step_rng(seed, step * count as u64 + index as u64);
            let mut found = loss(&mut rng)?;
            found.loss = (found.loss / count as f64)?;
            let gradients = found.loss.backward()?;
            Ok((found, gradients))
        };
        let work = || {
            let mut done = Vec::new();
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= count {
                    return done;
                }
                done.push((
                    index,
                    batch(index).and_then(|(loss, gradients)| {
                        Ok(StepLoss {
                            gradient: variables.gradients(&gradients, &loss.gradients)?,
                            loss: loss.loss.to_scalar()?,
                            parts: loss.parts,
                        })
                    }),
                ));
            }
        };
        let mut results = std::thread::scope(|scope| -> Result<Vec<_>> {
            let running: Vec<_> = self
                .pools
                .iter()
                .map(|pool| scope.spawn(|| pool.install(work)))
                .collect();
            let mut results = Vec::new();
            for worker in running {
                results.extend(
                    worker
                        .join()
                        .map_err(|_| anyhow!("a training thread panicked"))?,
                );
            }
            Ok(results)
        })?;
        // Sorted, so that sums do not depend on the speed of workers.
        results.sort_by_key(|(index, _)| *index);
        let results = results.into_iter().map(|(_, result)| result);
        let mut results = results.collect::<Result<Vec<StepLoss>>>()?.into_iter();
        let mut total = results.next().context("a step without batches")?;
        let rest: Vec<StepLoss> = results.collect();
        for batch in &rest {
            total.loss += batch.loss;
            for ((_, sum), (_, part)) in total.parts.iter_mut().zip(&batch.parts) {
                *sum += part;
            }
        }
        let sums = total.gradient.par_iter_mut().enumerate();
        sums.for_each(|(parameter, sums)| {
            let parts = rest
                .iter()
                .filter_map(|batch| batch.gradient.get(parameter));
            for part in parts {
                for (sum, part) in sums.iter_mut().zip(part) {
                    *sum += part;
                }
            }
        });
        for (_, part) in &mut total.parts {
            *part /= count as f64;
        }
        Ok(total)
    }
}
