//! Goals that are reached one after the other.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use crate::PlanError;
use crate::goals::latent_distance;

/// When a goal gives way to the next one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arrival {
    /// A goal is reached when its mean squared latent distance is below this share of that to the goal after it.
    pub share: f32,
    /// Model steps after which the next one is tried all the same.
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

/// How far one has come along several goals.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Waypoint {
    /// The goal to reach next.
    pub index: usize,
    /// For how many model steps it was tried.
    pub steps: f32,
}

impl Waypoint {
    /// Where one is `passed` model steps later, in `latent` (h, w, C): past all goals that are reached or were tried for
    /// too long, but never past the last of `goals`, (h, w, C) each.
    ///
    /// # Errors
    /// Where shapes differ.
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
pub fn timed(times_ns: &[i64], begin_ns: i64, step_ns: i64, horizon: usize) -> Vec<usize> {
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
    fn goals_are_passed_when_they_are_reached_or_were_tried_often_enough() {
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
        // In vain, for two steps; then the last goal, which stays.
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
        assert_eq!(timed(&times, 0, 400, 4), [0, 1, 1, 1]);
        assert_eq!(timed(&times, 190, 400, 2), [0, 1], "half a step late");
        assert_eq!(timed(&times, 250, 400, 2), [1, 1]);
        assert_eq!(timed(&times, 9_000, 400, 1), [1]);
        assert_eq!(timed(&[], 0, 400, 1), [0]);
    }
}
