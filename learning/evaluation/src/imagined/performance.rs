//! Execution of a scripted policy.

use nalgebra::Vector3;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use wm_sim::{EndEffectorAction, Environment, LARGEST_STEP_M, LARGEST_TURN_RAD, Target};

use super::scripted::ScriptedPolicy;

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
    /// Starts here. Policies of a seed share random numbers: a higher grade errs in the same direction, by more.
    pub fn new(policy: ScriptedPolicy, environment: &Environment, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        let target = match policy {
            ScriptedPolicy::Beside(mm) => {
                let aside = Vector3::new(angle.cos(), angle.sin(), 0.0) * metres(mm);
                beside(environment.goal().target, aside)
            }
            _ => environment.goal().target,
        };
        Self {
            policy,
            target,
            solution: environment.solution().len(),
            taken: 0,
            grippers: [environment.world().opening().round(); 2],
            rng,
        }
    }

    /// The next command.
    pub fn command(&mut self, environment: &Environment) -> EndEffectorAction {
        // Always drawn, so that later draws do not depend on the policy.
        let shift = normal(&mut self.rng);
        let any = any_action(&mut self.rng);
        let chance = self.rng.random_range(0..100);
        let [at_start, last] = self.grippers;
        let oracle = environment.oracle_for(&self.target);
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
