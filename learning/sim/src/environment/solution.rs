//! How a goal is attained: what the oracle does, and what comes of it.

use super::goal::Target;
use super::oracle;
use crate::world::{EndEffectorAction, World};

/// A goal that takes longer is left to another draw, actions: 12 s.
const LONGEST: usize = 60;
/// A solution ends within this share of the tolerance: its last picture is of a goal that is clearly attained.
const CLEARLY: f64 = 0.6;
/// What is not to be moved moves less than this, metres.
const STAYED_M: f64 = 0.002;

/// The oracle's actions, and the worlds that they lead from and to.
#[derive(Clone)]
pub struct Solution {
    start: World,
    actions: Vec<EndEffectorAction>,
    /// The world after each action.
    worlds: Vec<World>,
}

impl Solution {
    /// The way from `start` to `target`, or `None` if the oracle does not get there, if it moves another
    /// object on the way, or if it has to carry what is to be pushed.
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
