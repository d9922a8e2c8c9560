//! A task of the arm.

use std::fmt;

use anyhow::{Context as _, Result, ensure};
use wm_sim::{Environment, GoalKind, STEP_S, Variety};

/// A task of the suite's simulator, or of another world with its topics and services.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Task {
    name: String,
    limit: Limit,
}

/// How long an episode may take.
#[derive(Clone, Debug, PartialEq)]
enum Limit {
    /// In proportion to the simulator's own solution.
    OfSolution(GoalKind),
    /// So many steps.
    Steps(usize),
}

impl Task {
    /// The task `name`, for at most `longest_s` \[s\]. With 0, its time is that of the simulator's solution.
    ///
    /// # Errors
    /// Without `longest_s`, if the simulator does not have the task; or if `name` is no name for a file.
    pub(crate) fn new(name: &str, longest_s: f64) -> Result<Self> {
        let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_".contains(letter);
        ensure!(
            !name.is_empty() && name.chars().all(is_plain),
            "expected letters, digits, - and _, found {name:?}"
        );
        let limit = if longest_s > 0.0 {
            // An hour has 18000 steps.
            Limit::Steps((longest_s / STEP_S).ceil() as usize)
        } else {
            let kind = name.parse::<GoalKind>();
            Limit::OfSolution(kind.context("a task of another world needs longest_time")?)
        };
        Ok(Self {
            name: name.to_owned(),
            limit,
        })
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// The steps of 0.2 s that the episode of this seed may take: those of the solution times `patience`, and at least
    /// `least_s` \[s\].
    ///
    /// # Errors
    /// If the task has no solution with this seed.
    pub(crate) fn most_steps(&self, seed: u64, patience: f64, least_s: f64) -> Result<usize> {
        let kind = match self.limit {
            Limit::Steps(steps) => return Ok(steps),
            Limit::OfSolution(kind) => kind,
        };
        let environment = Environment::new(kind, seed, &Variety::default())?;
        // An episode has a few dozen steps.
        let of_solution = environment.solution().len() as f64 * patience;
        Ok(of_solution.max(least_s / STEP_S).ceil() as usize)
    }
}

impl fmt::Display for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn task_of_another_world_has_the_time_that_is_set() {
        let task = Task::new("drawer-open-v3", 30.0).unwrap();
        assert_eq!(task.most_steps(7, 5.0, 4.0).unwrap(), 150);
        assert_eq!(task.to_string(), "drawer-open-v3");
        let refused = Task::new("drawer-open-v3", 0.0).unwrap_err();
        assert!(
            format!("{refused:#}").contains("longest_time"),
            "{refused:#}"
        );
        for name in ["", "../push", "a b"] {
            assert!(Task::new(name, 30.0).is_err(), "{name:?}");
        }
    }

    #[test]
    fn task_of_the_simulator_has_the_time_of_its_solution() {
        let task = Task::new("reach", 0.0).unwrap();
        let steps = |patience| task.most_steps(5_000_000, patience, 0.2).unwrap();
        assert!(steps(1.0) > 1);
        assert_eq!(steps(3.0), 3 * steps(1.0));
        assert_eq!(task.most_steps(5_000_000, 0.1, 20.0).unwrap(), 100);
    }
}
