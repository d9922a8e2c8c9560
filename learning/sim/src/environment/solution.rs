//! The oracle's solution of a goal.

use super::goal::Target;
use super::oracle;
use crate::world::{EndEffectorAction, World};

/// Limit of a solution, actions: 12 s.
const LONGEST: usize = 60;
/// Share of the tolerance within which a solution ends, so that its last picture clearly shows the goal.
const CLEARLY: f64 = 0.6;
/// Tolerance for objects that must not move, metres.
const STAYED_M: f64 = 0.002;

/// The oracle's actions and their worlds.
#[derive(Clone)]
pub struct Solution {
    start: World,
    actions: Vec<EndEffectorAction>,
    /// The world after each action.
    worlds: Vec<World>,
}

impl Solution {
    /// Solves `target` from `start`; `None` if the oracle does not attain it, moves another object, or carries an object that
    /// must be pushed.
    pub fn of(target: &Target, start: &World) -> Option<Self> {
        let mut world = start.clone();
        let (mut actions, mut worlds) = (Vec::new(), Vec::new());
        while let Some(action) = oracle::command(target, &world) {
            if actions.len() == LONGEST {
                return None;
            }
            world.step(&action);
            actions.push(action);
            worlds.push(world.clone());
        }
        let carries = worlds.iter().any(|world| world.held().is_some());
        (target.met_by(&world)
            && target.distance_m(&world) < CLEARLY * target.tolerance_m()
            && carries == target.is_carried()
            && others_stayed(target, start, &world))
        .then_some(Self {
            start: start.clone(),
            actions,
            worlds,
        })
    }

    pub fn actions(&self) -> &[EndEffectorAction] {
        &self.actions
    }

    pub fn start(&self) -> &World {
        &self.start
    }

    /// The world after `step` actions, or at the end if there are fewer.
    pub fn after(&self, step: usize) -> &World {
        step.checked_sub(1)
            // Past the end, the last world counts.
            .map_or(&self.start, |at| self.worlds.get(at).unwrap_or(self.end()))
    }

    /// The world in the end.
    pub fn end(&self) -> &World {
        self.worlds.last().unwrap_or(&self.start)
    }
}

fn others_stayed(target: &Target, start: &World, end: &World) -> bool {
    let pairs = start.objects().iter().zip(end.objects());
    pairs.enumerate().all(|(index, (before, after))| {
        Some(index) == target.object() || (after.position() - before.position()).norm() < STAYED_M
    })
}
