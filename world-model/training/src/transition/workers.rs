use std::{
    collections::BTreeMap,
    sync::atomic::{AtomicUsize, Ordering},
};

use anyhow::{Context as _, Result, anyhow, ensure};
use candle_core::{Tensor, Var, backprop::GradStore};
use rayon::{ThreadPool, ThreadPoolBuilder};
use wm_model::transition::Transition;

use super::{ClipSource, Objective};
use crate::optimiser::step_rng;

/// Threads that each compute whole small batches by themselves.
///
/// Operations that are split over threads wait for each other at every layer; whole batches side by side do not.
pub(super) struct Workers {
    /// One pool of one thread a worker, so that operations within do not spread.
    pools: Vec<ThreadPool>,
}

impl Workers {
    pub(super) fn new(threads: usize) -> Result<Self> {
        ensure!(threads > 0, "0 threads, expected at least 1");
        let pools = (0..threads)
            .map(|_| ThreadPoolBuilder::new().num_threads(1).build())
            .collect::<Result<_, _>>()?;
        Ok(Self { pools })
    }

    pub(super) fn len(&self) -> usize {
        self.pools.len()
    }

    /// The mean loss over one step's clips, and its gradient.
    pub(super) fn step(
        &self,
        model: &Transition,
        vars: &BTreeMap<String, Var>,
        clips: &ClipSource<'_>,
        objective: &Objective,
        step: u64,
    ) -> Result<(f32, GradStore)> {
        let count = objective.clips / objective.micro_batch;
        let next = AtomicUsize::new(0);
        let batch = |index: usize| -> Result<(f32, GradStore)> {
            // A stream of its own for each batch, whichever worker takes it.
            let mut rng = step_rng(objective.seed, step * count as u64 + index as u64);
            let loss = objective.loss(model, clips, &mut rng)?;
            let loss = (loss / count as f64)?;
            Ok((loss.to_scalar()?, loss.backward()?))
        };
        let work = || {
            let mut done = Vec::new();
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= count {
                    return done;
                }
                done.push((index, batch(index)));
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
        // In this order, sums do not depend on which worker was faster.
        results.sort_by_key(|(index, _)| *index);
        let mut results = results.into_iter().map(|(_, result)| result);
        let (mut loss, mut total) = results.next().context("a step without clips")??;
        for result in results {
            let (part, gradients) = result?;
            loss += part;
            add(&mut total, &gradients, vars)?;
        }
        Ok((loss, total))
    }
}

fn add(total: &mut GradStore, part: &GradStore, vars: &BTreeMap<String, Var>) -> Result<()> {
    for var in vars.values() {
        let tensor: &Tensor = var.as_tensor();
        if let (Some(sum), Some(part)) = (total.get(tensor), part.get(tensor)) {
            let sum = (sum + part)?;
            total.insert(tensor, sum);
        }
    }
    Ok(())
}
