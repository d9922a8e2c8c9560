//! The part common to all searches: rolls out candidates and keeps the best.

use std::sync::Arc;

use crate::{
    Batch, Costs, PlanError, PlannedActions, Problem, Progress, Turn, Watch, Workers,
    workers::NoWorkers,
};

/// A running search.
pub(crate) struct Search<'s, 'p> {
    pub(crate) problem: &'s mut Problem<'p>,
    watch: Watch<'s>,
    /// Iterations started.
    iteration: usize,
    best: Option<ScoredCandidate>,
    iteration_costs: Vec<f32>,
    candidates: usize,
    rejected: usize,
    /// Whether the search has ended early.
    is_cut: bool,
    /// Standard deviation of the newest batch's costs.
    deviation: f32,
}

/// A candidate with a finite cost.
#[derive(Clone, Debug)]
pub(crate) struct ScoredCandidate {
    pub(crate) cost: f32,
    terms: Vec<f32>,
    /// Steps x searched values, within the limits.
    pub(crate) actions: Vec<f32>,
}

#[cfg(test)]
impl ScoredCandidate {
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

    /// The proposals, flattened.
    pub(crate) fn proposals(&self) -> Vec<Vec<f32>> {
        let proposals = self.problem.proposals.iter();
        proposals.map(|proposal| proposal.concat()).collect()
    }

    /// The first proposal or no motion, within the limits.
    pub(crate) fn start(&self) -> Vec<f32> {
        let first = self.problem.proposals.first();
        let start = first.map_or_else(|| vec![0.0; self.len()], |proposal| proposal.concat());
        self.problem.space.limit(start)
    }

    /// Rolls out a population and returns the candidates with a finite cost, cheapest first; ties keep their order.
    /// `None` if the search ended before the first batch.
    ///
    /// # Errors
    /// [`PlanError::NoFiniteCost`] if no cost is finite.
    pub(crate) fn iterate(
        &mut self,
        population: Vec<Vec<f32>>,
    ) -> Result<Option<Vec<ScoredCandidate>>, PlanError> {
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
        let is_better = |best: &ScoredCandidate| least.cost < best.cost;
        if self.best.as_ref().is_none_or(is_better) {
            self.best = Some(least.clone());
        }
        Ok(Some(scored))
    }

    /// Rolls out one candidate regardless of time, since it may be returned. `None` if its cost is not finite.
    pub(crate) fn try_one(
        &mut self,
        candidate: Vec<f32>,
    ) -> Result<Option<ScoredCandidate>, PlanError> {
        let batch = vec![self.problem.space.limit(candidate)];
        let costs = self.problem.costs(&batch)?;
        Ok(self.scored(&batch, costs).pop())
    }

    /// Cost of the best candidate seen.
    pub(crate) fn best_cost(&self) -> Option<f32> {
        self.best.as_ref().map(|best| best.cost)
    }

    /// The result: `chosen`, or the best candidate seen.
    pub(crate) fn finish(
        self,
        chosen: Option<ScoredCandidate>,
    ) -> Result<PlannedActions, PlanError> {
        let Some(ScoredCandidate {
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

    /// The candidates with a finite cost in order, and the number tried.
    fn score(
        &mut self,
        population: Vec<Vec<f32>>,
    ) -> Result<(Vec<ScoredCandidate>, usize), PlanError> {
        let space = self.problem.space;
        let limited: Vec<Vec<f32>> = population
            .into_iter()
            .map(|candidate| space.limit(candidate))
            .collect();
        let batches = limited.chunks(self.problem.batch).map(<[_]>::to_vec);
        let batches: Arc<[Batch]> = batches.collect();
        let mut no_workers = NoWorkers::default();
        let mut workers = self.problem.workers.take();
        let costed = match &mut workers {
            Some(workers) => self.cost(&batches, &mut **workers),
            None => self.cost(&batches, &mut no_workers),
        };
        self.problem.workers = workers;
        let costed = costed?;
        let tried = batches.iter().zip(&costed);
        let tried = tried.filter_map(|(batch, scored)| scored.as_ref().map(|_| batch.len()));
        let tried = tried.sum();
        Ok((costed.into_iter().flatten().flatten().collect(), tried))
    }

    /// The candidates with a finite cost of each batch; `None` for a batch after the end of the search. Who costs a
    /// batch affects only the time.
    fn cost(
        &mut self,
        batches: &Arc<[Batch]>,
        workers: &mut dyn Workers,
    ) -> Result<Vec<Option<Vec<ScoredCandidate>>>, PlanError> {
        let mut costed: Vec<Option<Vec<ScoredCandidate>>> = vec![None; batches.len()];
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

    /// The candidates of a batch with a finite cost.
    fn scored(&mut self, batch: &[Vec<f32>], costs: Costs) -> Vec<ScoredCandidate> {
        let scored: Vec<ScoredCandidate> = batch
            .iter()
            .zip(costs.total)
            .zip(costs.terms)
            .filter(|((_, cost), _)| cost.is_finite())
            .map(|((actions, cost), terms)| ScoredCandidate {
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

/// Unbiased standard deviation of costs; 0 if fewer than two.
fn deviation(scored: &[ScoredCandidate]) -> f32 {
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
