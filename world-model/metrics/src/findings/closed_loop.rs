//! Success rate of a planner in closed loop.

use std::fmt;

use crate::{MetricError, statistics::wilson};
use serde::Serialize;

/// Results of all episodes of a planner, in one process or live. `A` describes the run: at least task and planner.
#[derive(Clone, Debug, Serialize)]
pub struct ClosedLoop<A> {
    /// Description of the run.
    #[serde(flatten)]
    pub about: A,
    /// Share of successful episodes.
    pub success_rate: f64,
    /// Wilson's 95 % interval.
    pub interval: [f64; 2],
    /// `None` if nothing was planned.
    pub plan_ms: Option<Percentiles>,
    /// Mean number of candidates per plan.
    pub candidates: f64,
    /// Plans that took longer than a model step.
    pub deadline_misses: usize,
    /// All episodes.
    pub episodes: Vec<Episode>,
}

/// Time of a plan \[ms\].
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
}

/// One episode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Episode {
    /// Seed of its table, task and goal.
    pub seed: u64,
    /// Whether the task was completed in time.
    pub success: bool,
    /// Model steps.
    pub steps: usize,
    /// Remaining distance to the goal \[m\].
    pub distance_m: f64,
}

/// Cost of one plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanTime {
    /// Wall time \[ms\].
    pub ms: f64,
    /// Candidates rolled out.
    pub candidates: usize,
}

impl<A> ClosedLoop<A> {
    /// The findings of `episodes` with all their `plans`; a model step takes `step_ms`.
    ///
    /// # Errors
    /// `MetricError::Empty` without episodes.
    pub fn of(
        about: A,
        step_ms: f64,
        episodes: Vec<Episode>,
        plans: &[PlanTime],
    ) -> Result<Self, MetricError> {
        let successes = episodes.iter().filter(|episode| episode.success).count();
        let interval = wilson(successes, episodes.len())?;
        let mut times: Vec<f64> = plans.iter().map(|plan| plan.ms).collect();
        times.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let index = (share * (times.len() as f64 - 1.0)).round() as usize;
            times.get(index).copied()
        };
        let plan_ms = at(0.5)
            .zip(at(0.95))
            .map(|(p50, p95)| Percentiles { p50, p95 });
        let candidates: usize = plans.iter().map(|plan| plan.candidates).sum();
        Ok(Self {
            about,
            success_rate: successes as f64 / episodes.len() as f64,
            interval: [interval.low, interval.high],
            plan_ms,
            candidates: candidates as f64 / times.len().max(1) as f64,
            deadline_misses: times.iter().filter(|ms| **ms > step_ms).count(),
            episodes,
        })
    }
}

impl<A: Serialize> ClosedLoop<A> {
    /// JSON that ends with a newline.
    ///
    /// # Errors
    /// If `about` cannot be serialised.
    pub fn to_json(&self) -> serde_json::Result<String> {
        let mut text = serde_json::to_string_pretty(self)?;
        text.push('\n');
        Ok(text)
    }
}

impl<A: fmt::Display> fmt::Display for ClosedLoop<A> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [low, high] = self.interval;
        write!(
            f,
            "{}: {:.0} % of {} episodes [{:.0}, {:.0}]",
            self.about,
            self.success_rate * 100.0,
            self.episodes.len(),
            low * 100.0,
            high * 100.0
        )?;
        if let Some(Percentiles { p50, p95 }) = self.plan_ms {
            write!(
                f,
                "; a plan of {:.0} candidates takes {p50:.0} ms (p95 {p95:.0}), longer than a model step: {}",
                self.candidates, self.deadline_misses
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn successes_and_times_are_counted() {
        let episode = |seed| Episode {
            seed,
            success: seed > 0,
            steps: 3,
            distance_m: 0.01,
        };
        let plan = |ms: f64| PlanTime { ms, candidates: 12 };
        let plans: Vec<PlanTime> = (1..=100)
            .map(|index| plan(f64::from(index) * 5.0))
            .collect();
        let about = "reach by idm".to_owned();
        let found = ClosedLoop::of(about, 400.0, (0..4).map(episode).collect(), &plans).unwrap();
        assert_eq!(found.success_rate, 0.75);
        assert_eq!((found.candidates, found.deadline_misses), (12.0, 20));
        let text = found.to_string();
        assert!(
            text.starts_with("reach by idm: 75 % of 4 episodes"),
            "{text}"
        );
        assert!(ClosedLoop::of((), 400.0, Vec::new(), &plans).is_err());
        let idle = ClosedLoop::of(String::new(), 400.0, vec![episode(0)], &[]).unwrap();
        assert!(idle.plan_ms.is_none());
    }
}
