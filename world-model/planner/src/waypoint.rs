//! Goals in sequence.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use crate::PlanError;
use crate::goals::latent_distance;

/// When to move on to the next goal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arrival {
    /// A goal is reached when its mean squared latent distance is below this share of the distance to the next goal.
    pub share: f32,
    /// Model steps after which the next goal is tried anyway.
    pub steps: f32,
}

impl Default for Arrival {
    fn default() -> Self {
        Self {
            share: 0.3,
            steps: 4.0,
        }
    }
}

/// Position in a sequence of goals.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Waypoint {
    /// Index of the current goal.
    pub index: usize,
    /// Model steps spent on it.
    pub steps: f32,
}

impl Waypoint {
    /// The position `passed` model steps later, in `latent` (h, w, C): skips all `goals` (h, w, C) that are reached or
    /// timed out, but never the last.
    ///
    /// # Errors
    /// If shapes differ.
    pub fn advance(
        self,
        passed: f32,
        goals: &[Tensor],
        latent: &Tensor,
        arrival: Arrival,
    ) -> Result<Self, PlanError> {
        let mut at = Self {
            steps: self.steps + passed,
            ..self
        };
        while let (Some(goal), Some(next)) = (goals.get(at.index), goals.get(at.index + 1)) {
            let apart = latent_distance(goal, next)?;
            let is_near = latent_distance(latent, goal)? < arrival.share * apart;
            if !is_near && at.steps <= arrival.steps {
                break;
            }
            at = Self {
                index: at.index + 1,
                steps: 0.0,
            };
        }
        Ok(at)
    }
}

/// Which of several goals with times each of `horizon` model steps is to end at: the first one whose time has not passed
/// by more than half a step at the step's end, else the last. `times_ns` and `begin_ns` count from the same moment.
pub fn goals_by_time(times_ns: &[i64], begin_ns: i64, step_ns: i64, horizon: usize) -> Vec<usize> {
    let last = times_ns.len().saturating_sub(1);
    let mut end_ns = begin_ns;
    let of_step = |_| {
        end_ns = end_ns.saturating_add(step_ns);
        let is_ahead = |time_ns: &i64| time_ns.saturating_add(step_ns / 2) >= end_ns;
        times_ns.iter().position(is_ahead).unwrap_or(last)
    };
    (0..horizon).map(of_step).collect()
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    fn latent(value: f32) -> Tensor {
        Tensor::from_vec(vec![value; 2], (1, 1, 2), &Device::Cpu).unwrap()
    }

    #[test]
    fn goals_are_passed_when_reached_or_timed_out() {
        let goals = [latent(1.0), latent(2.0), latent(3.0)];
        let arrival = Arrival {
            share: 0.3,
            steps: 2.0,
        };
        let advance = |at: Waypoint, seen| at.advance(1.0, &goals, &latent(seen), arrival).unwrap();
        let at = |index, steps| Waypoint { index, steps };
        let far = advance(Waypoint::default(), 0.0);
        assert_eq!(far, at(0, 1.0));
        let near = advance(far, 0.9);
        assert_eq!(near, at(1, 0.0));
        // Two steps without success, then the last goal, which stays.
        let mut now = near;
        for steps in [1.0, 2.0] {
            now = advance(now, 0.9);
            assert_eq!(now, at(1, steps));
        }
        now = advance(now, 0.9);
        assert_eq!(now.index, 2);
        for _ in 0..5 {
            now = advance(now, 3.0);
        }
        assert_eq!(now.index, 2);
        let other = Tensor::from_vec(vec![0.0_f32; 3], (1, 1, 3), &Device::Cpu).unwrap();
        let refused = Waypoint::default().advance(1.0, &goals, &other, arrival);
        assert!(refused.is_err());
    }

    #[test]
    fn each_step_ends_at_the_goal_of_its_time() {
        let times = [400, 1200];
        assert_eq!(goals_by_time(&times, 0, 400, 4), [0, 1, 1, 1]);
        assert_eq!(
            goals_by_time(&times, 190, 400, 2),
            [0, 1],
            "half a step late"
        );
        assert_eq!(goals_by_time(&times, 250, 400, 2), [1, 1]);
        assert_eq!(goals_by_time(&times, 9_000, 400, 1), [1]);
        assert_eq!(goals_by_time(&[], 0, 400, 1), [0]);
    }
}
