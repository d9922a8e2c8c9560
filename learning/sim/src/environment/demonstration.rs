//! Demonstrations of goals by the oracle, with disturbed actions.

use nalgebra::Vector3;
use rand::Rng as _;
use rand::seq::IndexedRandom as _;
use rand_chacha::ChaCha8Rng;

use super::choice;
use super::goal::{GoalKind, Target};
use super::oracle;
use super::solution::Solution;
use crate::teleop::Task;
use crate::world::{EndEffectorAction, World};

/// Limit of goals drawn until one suits the table.
const DRAWS: usize = 60;
/// Actions after which a goal is given up: twice those of the longest solution.
const PATIENCE: usize = 120;
/// Largest disturbance along an axis, metres per action: the oracle's speed.
const DISTURBANCE_M: f64 = 0.04;
/// Longest spell of disturbed actions.
const LONGEST_SPELL: usize = 4;
/// Share of the spells that also turn the gripper's target around.
const GRIPPER_SHARE: f64 = 0.1;

/// One goal after another, pursued by the oracle. It has no memory, so after a spell of disturbed actions it shows the
/// way back.
pub struct Demonstration {
    goals: Vec<GoalKind>,
    viewer: [Vector3<f64>; 2],
    rng: ChaCha8Rng,
    /// Probability that a spell of disturbed actions begins at a step.
    begins: f64,
    spell: Option<Spell>,
    current: Option<(Target, usize)>,
    /// Tasks begun, in order.
    tasks: Vec<Task>,
    attained: usize,
}

struct Spell {
    left: usize,
    velocity: Vector3<f64>,
    turns_gripper: bool,
}

impl Demonstration {
    /// Demonstrates goals of these kinds for a viewer along `viewer`. A share of the actions is disturbed, drawn from 0 to
    /// `disturbance`.
    pub fn new(
        goals: Vec<GoalKind>,
        disturbance: f64,
        viewer: [Vector3<f64>; 2],
        mut rng: ChaCha8Rng,
    ) -> Self {
        let share = rng.random_range(0.0..=disturbance.clamp(0.0, 1.0));
        let length = (1 + LONGEST_SPELL) as f64 / 2.0;
        Self {
            goals,
            viewer,
            // Spells and the steps between them take turns.
            begins: (share / (length * (1.0 - share) + share)).clamp(0.0, 1.0),
            rng,
            spell: None,
            current: None,
            tasks: Vec::new(),
            attained: 0,
        }
    }

    /// The next command in `world`.
    pub fn command(&mut self, world: &World) -> EndEffectorAction {
        let command = self.undisturbed(world);
        if self.spell.is_none() && self.rng.random_bool(self.begins) {
            let mut axis = || self.rng.random_range(-DISTURBANCE_M..=DISTURBANCE_M);
            let velocity = Vector3::new(axis(), axis(), axis());
            self.spell = Some(Spell {
                left: self.rng.random_range(1..=LONGEST_SPELL),
                velocity,
                turns_gripper: self.rng.random_bool(GRIPPER_SHARE),
            });
        }
        let Some(spell) = &mut self.spell else {
            return command;
        };
        let disturbed = EndEffectorAction {
            translation: command.translation + spell.velocity,
            gripper: match spell.turns_gripper {
                true => 1.0 - command.gripper,
                false => command.gripper,
            },
            ..command
        };
        spell.left -= 1;
        if spell.left == 0 {
            self.spell = None;
        }
        super::within_limits(&disturbed)
    }

    /// The instructions in order, and whether the last goal is attained in `world`.
    pub fn conclude(&self, world: &World) -> (String, bool) {
        let sentences: Vec<_> = self
            .tasks
            .iter()
            .map(|task| task.instruction(world))
            .collect();
        let success = match &self.current {
            Some((target, _)) => target.met_by(world),
            None => self.attained > 0,
        };
        (sentences.join(", then "), success)
    }

    fn undisturbed(&mut self, world: &World) -> EndEffectorAction {
        if let Some((target, steps)) = &mut self.current {
            *steps += 1;
            match oracle::command(target, world) {
                Some(command) if *steps < PATIENCE => return command,
                Some(_) => {}
                None => self.attained += 1,
            }
            self.current = None;
        }
        let Some((target, task)) = self.draw(world) else {
            return oracle::at_rest(world);
        };
        self.tasks.push(task);
        self.current = Some((target, 0));
        // A drawn goal is not attained yet.
        oracle::command(&target, world).unwrap_or_else(|| oracle::at_rest(world))
    }

    fn draw(&mut self, world: &World) -> Option<(Target, Task)> {
        (0..DRAWS).find_map(|_| {
            let kind = *self.goals.choose(&mut self.rng)?;
            let (target, task) = choice::draw(kind, world, self.viewer, &mut self.rng)?;
            Solution::of(&target, world).map(|_| (target, task))
        })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;

    use super::*;
    use crate::layout;
    use crate::render::Camera;
    use crate::variety::Variety;

    fn demonstrate(disturbance: f64, seed: u64) -> (usize, usize, Vec<World>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut world = layout::lay_table(&Variety::default(), &mut rng);
        let viewer = Camera::beside_the_arm()
            .viewer_axes()
            .map(|axis| axis.cast());
        let goals = vec![GoalKind::Push, GoalKind::PickPlace];
        let mut demonstration = Demonstration::new(goals, disturbance, viewer, rng);
        let mut worlds = Vec::new();
        for _ in 0..80 {
            let command = demonstration.command(&world);
            world.step(&command);
            worlds.push(world.clone());
        }
        (demonstration.tasks.len(), demonstration.attained, worlds)
    }

    #[test]
    fn the_oracle_attains_one_goal_after_another() {
        let found: Vec<_> = (0..12).map(|seed| demonstrate(0.0, seed)).collect();
        let begun: usize = found.iter().map(|(begun, _, _)| begun).sum();
        let attained: usize = found.iter().map(|(_, attained, _)| attained).sum();
        assert!(begun >= 24, "{begun} goals begun");
        // The last goal of each is unfinished.
        assert!(attained + 12 >= begun, "{attained} of {begun}");
    }

    #[test]
    fn disturbed_demonstrations_differ_and_still_attain_goals() {
        let calm: Vec<_> = (0..12).map(|seed| demonstrate(0.0, seed)).collect();
        let found: Vec<_> = (0..12).map(|seed| demonstrate(0.6, seed)).collect();
        let attained = |all: &[(usize, usize, Vec<World>)]| -> usize {
            all.iter().map(|(_, attained, _)| attained).sum()
        };
        assert!(
            calm.iter()
                .zip(&found)
                .any(|(calm, found)| calm.2 != found.2)
        );
        let (calm, found) = (attained(&calm), attained(&found));
        assert!(found >= 8 && found <= calm, "{found} instead of {calm}");
    }
}
