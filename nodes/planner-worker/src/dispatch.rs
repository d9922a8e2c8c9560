//! Tracks the batches of a population, without network and clock.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use wm_planner::{Costs, Turn, WorkerCounts};

/// A worker may take this many times as long for a batch as the search itself. Then the search costs the batch too.
const HEDGE: u32 = 2;
/// A worker that takes this many times as long as the search is excluded for a while.
const LOST: u32 = 8;
/// The shortest wait before a worker is excluded, for delays of the network.
const LEAST_PATIENCE: Duration = Duration::from_secs(1);
/// The wait for a worker while the search's own duration is unknown.
const FIRST_PATIENCE: Duration = Duration::from_secs(10);

/// A batch of a worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Job {
    round: u64,
    /// Index of the batch.
    pub(crate) index: usize,
}

/// The reason why an unanswered batch is reclaimed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ReturnReason {
    TimedOut,
    Failed,
    Gone,
}

/// The next action of the search.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Next {
    Turn(Turn),
    /// Wait, at most this long.
    Wait(Duration),
    /// All batches are costed.
    Over,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// Not assigned.
    Open,
    /// Assigned to a worker at this time.
    Out(Instant),
    /// The search costs it, or has costed it. A worker's answer is late.
    Here,
    /// Costed by a worker.
    Answered,
}

/// The batches of the current population.
#[derive(Debug, Default)]
pub(crate) struct Dispatch {
    round: u64,
    batches: Vec<Place>,
    answers: VecDeque<(usize, Costs)>,
    /// Since when the search has been costing a batch.
    busy_since: Option<Instant>,
    /// The duration of the last batch of the search.
    own: Option<Duration>,
    pub(crate) counts: WorkerCounts,
}

impl Dispatch {
    /// Starts a population of `batches`.
    pub(crate) fn begin(&mut self, batches: usize) {
        self.end();
        self.batches = vec![Place::Open; batches];
    }

    /// Ends the population.
    pub(crate) fn end(&mut self) {
        self.round += 1;
        self.batches.clear();
        self.answers.clear();
        self.busy_since = None;
    }

    /// The last unassigned batch, for an idle worker; the search begins with the first. The first is reserved for the
    /// search, so that its duration is known.
    pub(crate) fn take(&mut self, now: Instant) -> Option<Job> {
        let open = self.batches.iter().rposition(|place| *place == Place::Open);
        let index = open.filter(|index| *index > 0)?;
        *self.batches.get_mut(index)? = Place::Out(now);
        let round = self.round;
        Some(Job { round, index })
    }

    /// The next action of the search at `now`.
    pub(crate) fn next(&mut self, now: Instant) -> Next {
        if let Some(since) = self.busy_since.take() {
            self.own = Some(now.saturating_duration_since(since));
        }
        if let Some((index, costs)) = self.answers.pop_front() {
            return Next::Turn(Turn::Answered(index, costs));
        }
        let places = || self.batches.iter().enumerate();
        if let Some((index, _)) = places().find(|(_, place)| **place == Place::Open) {
            return self.here(index, now);
        }
        let oldest = places().filter_map(|(index, place)| match place {
            Place::Out(since) => Some((*since, index)),
            _ => None,
        });
        let Some((since, index)) = oldest.min() else {
            return Next::Over;
        };
        // Before the first batch of the search, there is no estimate: the search costs this batch at once.
        let due = since + self.own.unwrap_or_default() * HEDGE;
        match due.checked_duration_since(now) {
            Some(left) if !left.is_zero() => Next::Wait(left),
            _ => self.here(index, now),
        }
    }

    fn here(&mut self, index: usize, now: Instant) -> Next {
        if let Some(place) = self.batches.get_mut(index) {
            *place = Place::Here;
        }
        self.busy_since = Some(now);
        Next::Turn(Turn::Here(index))
    }

    /// How long to wait for a worker.
    pub(crate) fn patience(&self) -> Duration {
        self.own
            .map_or(FIRST_PATIENCE, |own| (own * LOST).max(LEAST_PATIENCE))
    }

    /// A worker has costed its batch.
    pub(crate) fn answered(&mut self, job: Job, costs: Costs) {
        match self.place(job) {
            Some(place @ Place::Out(_)) => {
                *place = Place::Answered;
                self.answers.push_back((job.index, costs));
                self.counts.answered += 1;
            }
            _ => self.counts.late += 1,
        }
    }

    /// A worker returns its batch.
    pub(crate) fn returned(&mut self, job: Job, why: ReturnReason) {
        match why {
            ReturnReason::TimedOut => self.counts.timed_out += 1,
            ReturnReason::Failed => self.counts.failed += 1,
            // The counter of departed workers contains this one.
            ReturnReason::Gone => {}
        }
        if let Some(place @ Place::Out(_)) = self.place(job) {
            *place = Place::Open;
        }
    }

    /// The state of a job's batch, if it belongs to this population.
    fn place(&mut self, job: Job) -> Option<&mut Place> {
        let is_current = job.round == self.round;
        self.batches.get_mut(job.index).filter(|_| is_current)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: Duration = Duration::from_millis(100);

    fn costs(cost: f32) -> Costs {
        Costs::of_terms(vec![vec![cost]])
    }

    fn here(index: usize) -> Next {
        Next::Turn(Turn::Here(index))
    }

    #[test]
    fn search_takes_first_batches_and_workers_last_ones() {
        let now = Instant::now();
        let mut dispatch = Dispatch::default();
        assert_eq!(dispatch.take(now), None);
        dispatch.begin(4);
        let last = dispatch.take(now).unwrap();
        assert_eq!(last.index, 3);
        assert_eq!(dispatch.next(now), here(0));
        assert_eq!(dispatch.take(now).unwrap().index, 2);
        dispatch.answered(last, costs(3.0));
        let answered = Next::Turn(Turn::Answered(3, costs(3.0)));
        assert_eq!(dispatch.next(now + OWN), answered);
        assert_eq!(dispatch.next(now + OWN), here(1));
        assert_eq!(dispatch.counts.answered, 1);
    }

    #[test]
    fn first_batch_is_reserved_for_the_search() {
        let now = Instant::now();
        let mut dispatch = Dispatch::default();
        dispatch.begin(2);
        assert!(dispatch.take(now).is_some() && dispatch.take(now).is_none());
        assert_eq!(dispatch.next(now), here(0));
    }

    #[test]
    fn slow_workers_batch_is_costed_here_and_counted_once() {
        let start = Instant::now();
        let mut dispatch = Dispatch::default();
        dispatch.begin(2);
        let job = dispatch.take(start).unwrap();
        assert_eq!(dispatch.next(start), here(0));
        assert_eq!(dispatch.patience(), FIRST_PATIENCE);
        // The wait is about the duration of the batch here.
        assert_eq!(dispatch.next(start + OWN), Next::Wait(OWN));
        assert_eq!(dispatch.patience(), LEAST_PATIENCE);
        assert_eq!(dispatch.next(start + 2 * OWN), here(1));
        dispatch.answered(job, costs(1.0));
        assert_eq!(dispatch.next(start + 3 * OWN), Next::Over);
        assert_eq!((dispatch.counts.answered, dispatch.counts.late), (0, 1));
    }

    #[test]
    fn failed_workers_batch_is_available_again() {
        let now = Instant::now();
        for why in [
            ReturnReason::Failed,
            ReturnReason::TimedOut,
            ReturnReason::Gone,
        ] {
            let mut dispatch = Dispatch::default();
            dispatch.begin(2);
            let job = dispatch.take(now).unwrap();
            assert_eq!(dispatch.next(now), here(0));
            dispatch.returned(job, why);
            assert_eq!(dispatch.take(now), Some(job));
            dispatch.returned(job, why);
            assert_eq!(dispatch.next(now + OWN), here(1));
        }
    }

    #[test]
    fn answers_for_an_earlier_population_are_late() {
        let now = Instant::now();
        let mut dispatch = Dispatch::default();
        dispatch.begin(2);
        let job = dispatch.take(now).unwrap();
        dispatch.begin(2);
        let other = dispatch.take(now).unwrap();
        dispatch.answered(job, costs(1.0));
        dispatch.returned(job, ReturnReason::TimedOut);
        assert_eq!(dispatch.next(now), here(0));
        dispatch.answered(other, costs(2.0));
        let answered = Next::Turn(Turn::Answered(1, costs(2.0)));
        assert_eq!(dispatch.next(now + OWN), answered);
        let WorkerCounts {
            answered,
            late,
            timed_out,
            ..
        } = dispatch.counts;
        assert_eq!((answered, late, timed_out), (1, 1, 1));
    }
}
