//! Execution of a scripted policy.

use nalgebra::Vector3;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};

use super::Environment;
use super::goal::Target;
use super::oracle;
use super::policy::ScriptedPolicy;
use crate::teleop::{LARGEST_STEP_M, LARGEST_TURN_RAD};
use crate::world::{EndEffectorAction, World};

/// One episode of a policy.
#[derive(Clone, Debug)]
pub struct Performance {
    policy: ScriptedPolicy,
    /// Its assumed goal.
    target: Target,
    /// Number of the oracle's actions.
    solution: usize,
    /// Number of actions so far.
    taken: usize,
    /// The gripper at the start, and its last command.
    grippers: [f64; 2],
    rng: ChaCha8Rng,
}

impl Performance {
    /// Starts at the environment's present state. Policies of a seed share random numbers: a higher grade errs in the same
    /// direction, by more.
    pub fn new(policy: ScriptedPolicy, environment: &Environment) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(environment.seed());
        let aim = (environment.goal().target, environment.solution().len());
        Self::of(policy, aim, environment.world(), rng)
    }

    /// Starts in `world` towards a target that the oracle attains in `solution` actions.
    pub(crate) fn of(
        policy: ScriptedPolicy,
        (target, solution): (Target, usize),
        world: &World,
        mut rng: ChaCha8Rng,
    ) -> Self {
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        let target = match policy {
            ScriptedPolicy::Beside(mm) => {
                let aside = Vector3::new(angle.cos(), angle.sin(), 0.0) * metres(mm);
                beside(target, aside)
            }
            _ => target,
        };
        Self {
            policy,
            target,
            solution,
            taken: 0,
            grippers: [world.opening().round(); 2],
            rng,
        }
    }

    /// The next command in `world`.
    pub fn command(&mut self, world: &World) -> EndEffectorAction {
        // Always drawn, so that later draws do not depend on the policy.
        let shift = normal(&mut self.rng);
        let any = any_action(&mut self.rng);
        let chance = self.rng.random_range(0..100);
        let [at_start, last] = self.grippers;
        let oracle = oracle::command(&self.target, world).unwrap_or_else(|| oracle::at_rest(world));
        let command = match self.policy {
            ScriptedPolicy::Oracle | ScriptedPolicy::Beside(_) => oracle,
            ScriptedPolicy::Noise(mm) => EndEffectorAction {
                translation: oracle.translation + shift * metres(mm),
                ..oracle
            },
            ScriptedPolicy::Distracted(percent) if chance < percent => any,
            ScriptedPolicy::Distracted(_) => oracle,
            ScriptedPolicy::Slow(percent) => EndEffectorAction {
                translation: oracle.translation * share(percent),
                rotation: oracle.rotation * share(percent),
                ..oracle
            },
            ScriptedPolicy::Stop(percent) => {
                // An episode has a few dozen actions.
                let is_over = self.taken as f64 >= share(percent) * self.solution as f64;
                if is_over {
                    EndEffectorAction::still(last)
                } else {
                    oracle
                }
            }
            ScriptedPolicy::FrozenGripper => EndEffectorAction {
                gripper: at_start,
                ..oracle
            },
            ScriptedPolicy::Random => any,
            ScriptedPolicy::Hold => EndEffectorAction::still(last),
        };
        self.taken += 1;
        self.grippers = [at_start, command.gripper];
        command
    }
}

fn metres(mm: u32) -> f64 {
    f64::from(mm) / 1000.0
}

fn share(percent: u32) -> f64 {
    f64::from(percent) / 100.0
}

fn beside(target: Target, aside: Vector3<f64>) -> Target {
    match target {
        Target::Tool { position } => Target::Tool {
            position: position + aside,
        },
        Target::Object {
            object,
            place,
            carried,
        } => Target::Object {
            object,
            place: place + aside,
            carried,
        },
    }
}

fn normal(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| StandardNormal.sample(rng))
}

fn any_action(rng: &mut ChaCha8Rng) -> EndEffectorAction {
    let mut motion = |largest: f64| Vector3::from_fn(|_, _| rng.random_range(-largest..=largest));
    EndEffectorAction {
        translation: motion(LARGEST_STEP_M),
        rotation: motion(LARGEST_TURN_RAD),
        gripper: f64::from(rng.random_range(0..=1_u8)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::GoalKind;
    use crate::variety::Variety;

    const SEED: u64 = 5_000_000;

    /// Share of pushes and carries with success.
    fn attained(policy: ScriptedPolicy) -> f64 {
        let episodes = [GoalKind::Push, GoalKind::PickPlace]
            .into_iter()
            .flat_map(|kind| (SEED..SEED + 10).map(move |seed| (kind, seed)));
        let attained = episodes.map(|(kind, seed)| {
            let mut environment =
                Environment::new(kind, seed, &Variety::default()).expect("a goal");
            let mut performance = Performance::new(policy, &environment);
            for _ in 0..environment.solution().len() * 3 / 2 {
                let command = performance.command(environment.world());
                environment.step(&command).expect("a finite action");
            }
            f64::from(u8::from(environment.solved()))
        });
        attained.sum::<f64>() / 20.0
    }

    #[test]
    fn higher_fault_grade_succeeds_less() {
        assert_eq!(attained(ScriptedPolicy::Oracle), 1.0);
        assert_eq!(attained(ScriptedPolicy::Hold), 0.0);
        let falling: [[ScriptedPolicy; 2]; 4] = [
            [ScriptedPolicy::Noise(5), ScriptedPolicy::Noise(80)],
            [
                ScriptedPolicy::Distracted(5),
                ScriptedPolicy::Distracted(70),
            ],
            [ScriptedPolicy::Beside(5), ScriptedPolicy::Beside(80)],
            [ScriptedPolicy::Stop(99), ScriptedPolicy::Stop(40)],
        ];
        for grades in falling {
            let [low, high] = grades.map(attained);
            assert!(low > high + 0.3, "{grades:?}: {low}, {high}");
        }
    }
}
