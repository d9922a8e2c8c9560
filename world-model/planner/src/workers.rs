//! Others who cost candidates, while the search does so itself.

use std::{fmt::Debug, sync::Arc};

use crate::{Costs, Objective, SearchSpace, TransitionDynamics};

/// Candidates that are costed together, each of steps x searched values within the limits.
pub type Batch = Vec<Vec<f32>>;

/// What a search does next about a population.
#[derive(Clone, Debug, PartialEq)]
pub enum Turn {
    /// It costs the batch of this index itself.
    Here(usize),
    /// A worker has costed the batch of this index.
    Answered(usize, Costs),
}

/// Workers for one plan. What they answer is what the search itself would have found, bit for bit.
pub trait Workers: Send {
    /// Hands out the batches of a population.
    fn offer(&mut self, batches: &Arc<[Batch]>);

    /// What the search does next; waits while workers have all that is left. Every batch comes at least once, and may come
    /// again; `None` when nothing is left.
    fn next(&mut self) -> Option<Turn>;

    /// Takes back what was handed out.
    fn withdraw(&mut self);
}

/// Workers that are there for plan after plan.
pub trait WorkerPool: Debug + Send + Sync {
    /// Has them take part in a plan of `horizon` steps; `None` where none could: there are none, another plan has them, or
    /// a term of the objective cannot be handed to them, which is counted.
    fn share(
        &self,
        dynamics: &TransitionDynamics<'_>,
        objective: &Objective,
        space: &SearchSpace,
        horizon: usize,
    ) -> Option<Box<dyn Workers>>;

    /// How they do.
    fn counts(&self) -> WorkerCounts;
}

/// How workers do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkerCounts {
    /// Workers that take part now.
    pub taking_part: usize,
    /// Workers that are there now, but would compute something else: another model, another version or processor.
    pub refused: usize,
    /// Batches that workers have costed.
    pub answered: u64,
    /// Batches that a worker did not answer in time.
    pub timed_out: u64,
    /// Batches that a worker answered too late to be of use.
    pub late: u64,
    /// Batches that a worker refused, or answered by nonsense.
    pub failed: u64,
    /// Workers that went away.
    pub gone: u64,
    /// Plans that no worker could take part in: a term of the cost that cannot be handed over.
    pub unshared: u64,
}

/// Nobody but the search itself.
#[derive(Debug, Default)]
pub(crate) struct Alone {
    next: usize,
    count: usize,
}

impl Workers for Alone {
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

    /// Costs every other batch from the end, and answers some of them twice.
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

    /// Some candidates fall off it.
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
    fn a_plan_does_not_depend_on_who_costs_what_and_in_which_order() {
        let alone = plan(None);
        assert!(alone.rejected > 0);
        let mut workers = from_the_end();
        assert_eq!(plan(Some(&mut workers)), alone);
        assert_eq!(workers.withdrawn, 3);
    }

    #[test]
    fn what_was_handed_out_is_taken_back_when_the_time_is_over() {
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
