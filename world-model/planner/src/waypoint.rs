//! Goals that are reached one after the other.

use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use crate::PlanError;

/// When a goal gives way to the next one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arrival {
    /// A goal is reached when its mean squared latent distance is below this share of that to the goal after it.
    pub share: f32,
    /// Plans made for a goal at most; the next one is tried then.
    pub plans: usize,
}

impl Default for Arrival {
    fn default() -> Self {
        Self {
            share: 0.3,
            plans: 4,
        }
    }
}

/// How far one has come along several goals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Waypoint {
    /// The goal to reach next.
    pub index: usize,
    /// Plans that were made for it.
    pub plans: usize,
}

impl Waypoint {
    /// Where one is when `observed` (h, w, C) is seen and another plan is to be made: past all goals that are reached or
    /// were tried often enough, but never past the last of `goals`, (h, w, C) each.
    ///
    /// # Errors
    /// Where shapes differ.
    pub fn advance(
        self,
        goals: &[Tensor],
        observed: &Tensor,
        arrival: Arrival,
    ) -> Result<Self, PlanError> {
        let mut at = Self {
            plans: self.plans + 1,
            ..self
        };
        while let (Some(goal), Some(next)) = (goals.get(at.index), goals.get(at.index + 1)) {
            let is_near =
                latent_distance(observed, goal)? < arrival.share * latent_distance(goal, next)?;
            if !is_near && at.plans <= arrival.plans {
                break;
            }
            at = Self {
                index: at.index + 1,
                plans: 0,
            };
        }
        Ok(at)
    }
}

/// Mean squared error of two latents of one shape, in normalised units squared.
///
/// # Errors
/// Where shapes differ.
pub fn latent_distance(a: &Tensor, b: &Tensor) -> Result<f32, PlanError> {
    Ok((a - b)?.sqr()?.mean_all()?.to_scalar::<f32>()?)
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
            plans: 2,
        };
        let advance = |at: Waypoint, seen| at.advance(&goals, &latent(seen), arrival).unwrap();
        let far = advance(Waypoint::default(), 0.0);
        assert_eq!(far, Waypoint { index: 0, plans: 1 });
        let near = advance(far, 0.9);
        assert_eq!(near, Waypoint { index: 1, plans: 0 });
        // In vain, twice; then the last goal, which stays.
        let mut at = near;
        for plans in 1..=2 {
            at = advance(at, 0.9);
            assert_eq!(at, Waypoint { index: 1, plans });
        }
        at = advance(at, 0.9);
        assert_eq!(at.index, 2);
        for _ in 0..5 {
            at = advance(at, 3.0);
        }
        assert_eq!(at.index, 2);
        let other = Tensor::from_vec(vec![0.0_f32; 3], (1, 1, 3), &Device::Cpu).unwrap();
        let refused = Waypoint::default().advance(&goals, &other, arrival);
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
