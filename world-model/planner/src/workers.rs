//! Processes that cost candidates beside the search.

use std::{fmt::Debug, sync::Arc};

use crate::{Costs, Objective, SearchSpace, TransitionDynamics};

/// Candidates that are costed together, each of steps x searched values within the limits.
pub type Batch = Vec<Vec<f32>>;

/// The next action of a search on its population.
#[derive(Clone, Debug, PartialEq)]
pub enum Turn {
    /// The search costs the batch of this index itself.
    Here(usize),
    /// A worker has costed the batch of this index.
    Answered(usize, Costs),
}

/// Workers for one plan. Their costs equal those of the search, bit for bit.
pub trait Workers: Send {
    /// Distributes the batches of a population.
    fn offer(&mut self, batches: &Arc<[Batch]>);

    /// The next turn; blocks while workers hold all remaining batches. Every batch comes at least once, and may repeat.
    /// `None` if no batch is left.
    fn next(&mut self) -> Option<Turn>;

    /// Reclaims the distributed batches.
    fn withdraw(&mut self);
}

/// Workers that serve many plans.
pub trait WorkerPool: Debug + Send + Sync {
    /// Workers for a plan of `horizon` steps. `None` if there are none, another plan uses them, or a term of the
    /// objective is not portable, which is counted.
    fn share(
        &self,
        dynamics: &TransitionDynamics<'_>,
        objective: &Objective,
        space: &SearchSpace,
        horizon: usize,
    ) -> Option<Box<dyn Workers>>;

    /// Counters since the start.
    fn counts(&self) -> WorkerCounts;
}

/// Counters of a worker pool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkerCounts {
    /// Workers in use now.
    pub taking_part: usize,
    /// Workers present now, but with another model, version or processor.
    pub refused: usize,
    /// Batches that workers have costed.
    pub answered: u64,
    /// Batches that a worker did not answer in time.
    pub timed_out: u64,
    /// Batches answered too late to be used.
    pub late: u64,
    /// Batches that a worker rejected or answered wrongly.
    pub failed: u64,
    /// Workers that disappeared.
    pub gone: u64,
    /// Plans without workers because a cost term is not portable.
    pub unshared: u64,
}

/// No workers: the search costs all batches itself.
#[derive(Debug, Default)]
pub(crate) struct NoWorkers {
    next: usize,
    count: usize,
}

impl Workers for NoWorkers {
    fn offer(&mut self, batches: &Arc<[Batch]>) {
        (self.next, self.count) = (0, batches.len());
    }

    fn next(&mut self) -> Option<Turn> {
        let index = self.next;
        self.next += 1;
        (index < self.count).then_some(Turn::Here(index))
    }

    fn withdraw(&mut self) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Cem, CemSettings, PlannedActions, Planner as _, Problem,
        testing::{Point, bounds, objective, problem},
    };

    /// Costs every other batch from the end, and answers some twice.
    struct FromTheEnd {
        evaluate: Box<dyn FnMut(&Batch) -> Costs + Send>,
        turns: Vec<Turn>,
        withdrawn: usize,
    }

    impl Workers for FromTheEnd {
        fn offer(&mut self, batches: &Arc<[Batch]>) {
            self.turns = Vec::new();
            for (index, batch) in batches.iter().enumerate() {
                let answer = |costs| Turn::Answered(index, costs);
                match index % 3 {
                    0 => self.turns.push(Turn::Here(index)),
                    1 => self.turns.push(answer((self.evaluate)(batch))),
                    _ => {
                        self.turns.push(answer((self.evaluate)(batch)));
                        self.turns.push(Turn::Here(index));
                    }
                }
            }
        }

        fn next(&mut self) -> Option<Turn> {
            self.turns.pop()
        }

        fn withdraw(&mut self) {
            self.withdrawn += 1;
        }
    }

    const GOAL: &[f32] = &[0.7, -0.4];

    /// A world where some candidates have no finite cost.
    fn cliff() -> Point {
        Point {
            cliff: 0.8,
            ..Point::new(2)
        }
    }

    fn from_the_end() -> FromTheEnd {
        let evaluate = |batch: &Batch| {
            let (space, objective, mut point) = (bounds(), objective(GOAL), cliff());
            let costs = problem(&space, &mut point, &objective).costs(batch);
            costs.unwrap()
        };
        FromTheEnd {
            evaluate: Box::new(evaluate),
            turns: Vec::new(),
            withdrawn: 0,
        }
    }

    fn plan(workers: Option<&mut (dyn Workers + 'static)>) -> PlannedActions {
        let (space, objective, mut point) = (bounds(), objective(GOAL), cliff());
        let mut problem = problem(&space, &mut point, &objective);
        problem.batch = 7;
        problem.workers = workers;
        let settings = CemSettings {
            population: 61,
            iterations: 3,
            elites: 8,
            ..CemSettings::default()
        };
        let cem = Cem::new(settings).unwrap();
        cem.plan(&mut problem, 3, &mut |_| false).unwrap()
    }

    #[test]
    fn plan_does_not_depend_on_workers() {
        let alone = plan(None);
        assert!(alone.rejected > 0);
        let mut workers = from_the_end();
        assert_eq!(plan(Some(&mut workers)), alone);
        assert_eq!(workers.withdrawn, 3);
    }

    #[test]
    fn batches_are_reclaimed_at_the_deadline() {
        let (space, objective, mut point) = (bounds(), objective(GOAL), cliff());
        let mut workers = from_the_end();
        let mut problem = Problem {
            batch: 100,
            workers: Some(&mut workers),
            ..problem(&space, &mut point, &objective)
        };
        let cem = Cem::new(CemSettings::default()).unwrap();
        let cut = cem.plan(&mut problem, 3, &mut |_| true).unwrap();
        assert!(cut.deadline_cut && cut.candidates == 100, "{cut:?}");
        assert_eq!(workers.withdrawn, 1);
    }
}
