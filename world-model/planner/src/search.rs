//! What all searches have in common: rolling candidates out, and keeping the best.

use std::sync::Arc;

use crate::{
    Batch, Costs, PlanError, PlannedActions, Problem, Progress, Turn, Watch, Workers,
    workers::Alone,
};

/// A search that goes on.
pub(crate) struct Search<'s, 'p> {
    pub(crate) problem: &'s mut Problem<'p>,
    watch: Watch<'s>,
    /// Iterations begun.
    iteration: usize,
    best: Option<Scored>,
    iteration_costs: Vec<f32>,
    candidates: usize,
    rejected: usize,
    /// No more candidates are to be rolled out.
    is_cut: bool,
    /// Of the newest batch.
    deviation: f32,
}

/// A candidate that was rolled out.
#[derive(Clone, Debug)]
pub(crate) struct Scored {
    pub(crate) cost: f32,
    terms: Vec<f32>,
    /// Steps x searched values, within the limits.
    pub(crate) actions: Vec<f32>,
}

#[cfg(test)]
impl Scored {
    pub(crate) fn of(cost: f32, actions: Vec<f32>) -> Self {
        Self {
            cost,
            terms: Vec::new(),
            actions,
        }
    }
}

impl<'s, 'p> Search<'s, 'p> {
    pub(crate) fn new(problem: &'s mut Problem<'p>, watch: Watch<'s>) -> Result<Self, PlanError> {
        problem.validate()?;
        Ok(Self {
            problem,
            watch,
            iteration: 0,
            best: None,
            iteration_costs: Vec::new(),
            candidates: 0,
            rejected: 0,
            is_cut: false,
            deviation: 0.0,
        })
    }

    /// Values of a plan, steps x searched values.
    fn len(&self) -> usize {
        self.problem.horizon * self.problem.space.len()
    }

    /// The proposals, flat.
    pub(crate) fn proposals(&self) -> Vec<Vec<f32>> {
        let proposals = self.problem.proposals.iter();
        proposals.map(|proposal| proposal.concat()).collect()
    }

    /// The plan to begin from, within the limits: the first proposal, or no motion.
    pub(crate) fn start(&self) -> Vec<f32> {
        let first = self.problem.proposals.first();
        let start = first.map_or_else(|| vec![0.0; self.len()], |proposal| proposal.concat());
        self.problem.space.limit(start)
    }

    /// Rolls a population out and returns those with a finite cost, the cheapest first; equal costs keep their order.
    /// `None` where the search was ended before the first batch of this iteration.
    ///
    /// # Errors
    /// [`PlanError::NoFiniteCost`] where not one cost is finite.
    pub(crate) fn iterate(
        &mut self,
        population: Vec<Vec<f32>>,
    ) -> Result<Option<Vec<Scored>>, PlanError> {
        if self.is_cut || (self.iteration > 0 && self.is_over()) {
            self.is_cut = true;
            return Ok(None);
        }
        self.iteration += 1;
        let (mut scored, tried) = self.score(population)?;
        scored.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let Some(least) = scored.first() else {
            return Err(PlanError::NoFiniteCost {
                iteration: self.iteration,
                candidates: tried,
            });
        };
        self.iteration_costs.push(least.cost);
        let is_better = |best: &Scored| least.cost < best.cost;
        if self.best.as_ref().is_none_or(is_better) {
            self.best = Some(least.clone());
        }
        Ok(Some(scored))
    }

    /// Rolls one more candidate out, whatever the time: it may be what is returned. `None` where its cost is not finite.
    pub(crate) fn try_one(&mut self, candidate: Vec<f32>) -> Result<Option<Scored>, PlanError> {
        let batch = vec![self.problem.space.limit(candidate)];
        let costs = self.problem.costs(&batch)?;
        Ok(self.scored(&batch, costs).pop())
    }

    /// Cost of the best candidate seen.
    pub(crate) fn best_cost(&self) -> Option<f32> {
        self.best.as_ref().map(|best| best.cost)
    }

    /// The plan of `chosen`, or of the best candidate seen.
    pub(crate) fn finish(self, chosen: Option<Scored>) -> Result<PlannedActions, PlanError> {
        let Some(Scored {
            cost,
            terms,
            actions,
        }) = chosen.or(self.best)
        else {
            return Err(PlanError::NoFiniteCost {
                iteration: self.iteration,
                candidates: self.candidates,
            });
        };
        let values = self.problem.space.len();
        Ok(PlannedActions {
            actions: actions.chunks_exact(values).map(<[f32]>::to_vec).collect(),
            cost,
            terms,
            iteration_costs: self.iteration_costs,
            elites: Vec::new(),
            candidates: self.candidates,
            rejected: self.rejected,
            deadline_cut: self.is_cut,
        })
    }

    /// Those of a population with a finite cost, in order, and how many were tried before the search was ended.
    fn score(&mut self, population: Vec<Vec<f32>>) -> Result<(Vec<Scored>, usize), PlanError> {
        let space = self.problem.space;
        let limited: Vec<Vec<f32>> = population
            .into_iter()
            .map(|candidate| space.limit(candidate))
            .collect();
        let batches = limited.chunks(self.problem.batch).map(<[_]>::to_vec);
        let batches: Arc<[Batch]> = batches.collect();
        let mut alone = Alone::default();
        let mut workers = self.problem.workers.take();
        let costed = match &mut workers {
            Some(workers) => self.cost(&batches, &mut **workers),
            None => self.cost(&batches, &mut alone),
        };
        self.problem.workers = workers;
        let costed = costed?;
        let tried = batches.iter().zip(&costed);
        let tried = tried.filter_map(|(batch, scored)| scored.as_ref().map(|_| batch.len()));
        let tried = tried.sum();
        Ok((costed.into_iter().flatten().flatten().collect(), tried))
    }

    /// The candidates of each batch that have a finite cost; `None` for a batch before which the search was ended. Which
    /// batches are costed here makes no difference but for the time.
    fn cost(
        &mut self,
        batches: &Arc<[Batch]>,
        workers: &mut dyn Workers,
    ) -> Result<Vec<Option<Vec<Scored>>>, PlanError> {
        let mut costed: Vec<Option<Vec<Scored>>> = vec![None; batches.len()];
        let mut left = batches.len();
        workers.offer(batches);
        while left > 0 {
            if left < batches.len() && self.is_over() {
                self.is_cut = true;
                break;
            }
            let (index, answer) = match workers.next() {
                Some(Turn::Here(index)) => (index, None),
                Some(Turn::Answered(index, costs)) => (index, Some(costs)),
                None => break,
            };
            let (Some(slot @ None), Some(batch)) = (costed.get_mut(index), batches.get(index))
            else {
                continue;
            };
            let costs = match answer {
                Some(costs) => costs,
                None => self.problem.costs(batch)?,
            };
            *slot = Some(self.scored(batch, costs));
            left -= 1;
        }
        workers.withdraw();
        Ok(costed)
    }

    /// Those of a batch with a finite cost.
    fn scored(&mut self, batch: &[Vec<f32>], costs: Costs) -> Vec<Scored> {
        let scored: Vec<Scored> = batch
            .iter()
            .zip(costs.total)
            .zip(costs.terms)
            .filter(|((_, cost), _)| cost.is_finite())
            .map(|((actions, cost), terms)| Scored {
                cost,
                terms,
                actions: actions.clone(),
            })
            .collect();
        self.candidates += batch.len();
        self.rejected += batch.len() - scored.len();
        self.deviation = deviation(&scored);
        scored
    }

    fn is_over(&mut self) -> bool {
        let best = self.best.as_ref();
        (self.watch)(&Progress {
            iteration: self.iteration.max(1),
            candidates: self.candidates,
            best: best.map(|best| best.cost),
            terms: best.map_or(&[], |best| best.terms.as_slice()),
            deviation: self.deviation,
        })
    }
}

/// Unbiased standard deviation of costs; 0 for fewer than two.
fn deviation(scored: &[Scored]) -> f32 {
    if scored.len() < 2 {
        return 0.0;
    }
    // Counts stay far below 2^52.
    let count = scored.len() as f64;
    let costs = || scored.iter().map(|scored| f64::from(scored.cost));
    let mean = costs().sum::<f64>() / count;
    let squares: f64 = costs().map(|cost| (cost - mean).powi(2)).sum();
    (squares / (count - 1.0)).sqrt() as f32
}
