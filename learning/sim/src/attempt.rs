//! An operator's attempt at an episode.

use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::environment::{Demonstration, Environment, Performance, ScriptedPolicy};
use crate::episode_options::EpisodeOptions;
use crate::error::Error;
use crate::render::Camera;
use crate::teleop::{Assignment, Failure, Operator};
use crate::world::{EndEffectorAction, World};

/// Share of the demonstrations that are free motion.
const EXPLORATION_SHARE: f64 = 0.2;
/// Limit of attempts until an episode ends as planned.
const ATTEMPTS: u64 = 12;
/// Random stream of demonstrations by the oracle; operators use the first ones.
const ORACLE_STREAM: u64 = 32;

/// The result of an operator's actions on a world, without pictures.
#[derive(Default)]
pub struct Attempt {
    /// The world at each frame, and the action taken there.
    pub steps: Vec<(World, [f32; 7])>,
    pub instruction: String,
    pub success: bool,
    pub failure: Option<Failure>,
}

impl Attempt {
    /// The attempt for the episode of `seed`, in `world` as `camera` shows it.
    ///
    /// The result may differ from the operator's intention; then the attempt is discarded, and another is made.
    pub fn of(seed: u64, options: &EpisodeOptions, camera: &Camera, world: World) -> Self {
        let viewer = camera.viewer_axes().map(|axis| axis.cast());
        // Each attempt has its own random stream.
        let rng = |stream| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(stream);
            rng
        };
        if !options.goals.is_empty() {
            let (goals, disturbance) = (options.goals.clone(), options.disturbance);
            let oracle = Demonstration::new(goals, disturbance, viewer, rng(ORACLE_STREAM));
            return Self::demonstrate(oracle, world, options.frames);
        }
        let mut chance = rng(1);
        let fails = chance.random_bool(options.failures.clamp(0.0, 1.0));
        let explores = chance.random_bool(EXPLORATION_SHARE);
        let mut attempt = Self::default();
        for number in 0..ATTEMPTS {
            let mut rng = rng(2 + number);
            let assignment = if fails {
                Assignment::OneTask(Failure::ALL.choose(&mut rng).copied())
            } else if options.failures > 0.0 {
                Assignment::OneTask(None)
            } else if explores {
                Assignment::Exploration
            } else {
                Assignment::Tasks
            };
            let operator = Operator::new(rng, viewer, &world, assignment);
            attempt = Self::make(operator, world.clone(), options.frames);
            if let Assignment::OneTask(failure) = assignment {
                attempt.failure = failure;
            }
            if attempt.success != fails {
                break;
            }
        }
        attempt
    }

    /// An attempt at an environment's goal, by commands limited as in [`Environment::step`]. It succeeds if the final state
    /// fulfils the instruction.
    ///
    /// # Errors
    /// If a command is not finite.
    pub fn of_policy(
        policy: ScriptedPolicy,
        mut environment: Environment,
        frames: usize,
    ) -> Result<Self, Error> {
        let mut performance = Performance::new(policy, &environment);
        let mut steps = Vec::with_capacity(frames);
        for _ in 0..frames {
            let before = environment.world().clone();
            let command = performance.command(&before);
            steps.push((before, environment.step(&command)?.values()));
        }
        Ok(Self {
            steps,
            instruction: environment.instruction().to_owned(),
            success: environment.instruction_followed(),
            failure: None,
        })
    }

    fn make(mut operator: Operator, mut world: World, frames: usize) -> Self {
        let steps = record(&mut world, frames, |world, left| {
            operator.command(world, left)
        });
        let (instruction, success) = operator.conclude(&world);
        Self {
            steps,
            instruction,
            success,
            failure: None,
        }
    }

    fn demonstrate(mut oracle: Demonstration, mut world: World, frames: usize) -> Self {
        let steps = record(&mut world, frames, |world, _| oracle.command(world));
        let (instruction, success) = oracle.conclude(&world);
        Self {
            steps,
            instruction,
            success,
            failure: None,
        }
    }
}

/// Executes `frames` commands, each for the world and the number of frames left.
fn record(
    world: &mut World,
    frames: usize,
    mut command: impl FnMut(&World, usize) -> EndEffectorAction,
) -> Vec<(World, [f32; 7])> {
    let mut steps = Vec::with_capacity(frames);
    for index in 0..frames {
        let command = command(world, frames - index);
        let before = world.clone();
        let action = world.step(&command).values();
        steps.push((before, action));
    }
    steps
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout;

    fn outcome(seed: u64, options: &EpisodeOptions) -> Attempt {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let world = layout::lay_table(&options.variety, &mut rng);
        Attempt::of(seed, options, &Camera::beside_the_arm(), world)
    }

    #[test]
    fn failures_have_the_requested_share_and_every_kind() {
        let options = EpisodeOptions {
            failures: 0.667,
            ..EpisodeOptions::default()
        };
        let mut failed = 0;
        let mut kinds = std::collections::BTreeSet::new();
        for seed in 0..60 {
            let outcome = outcome(seed, &options);
            failed += u32::from(!outcome.success);
            if let (false, Some(kind)) = (outcome.success, outcome.failure) {
                kinds.insert(kind);
            }
            assert!(!outcome.instruction.contains(", then "));
        }
        assert!((32..=48).contains(&failed), "{failed} of 60");
        assert_eq!(kinds.len(), Failure::ALL.len(), "{kinds:?}");
    }

    #[test]
    fn without_failures_nearly_all_attempts_succeed() {
        let options = EpisodeOptions::default();
        let failed = (0..60)
            .filter(|seed| !outcome(*seed, &options).success)
            .count();
        assert!(failed <= 1, "{failed} of 60");
    }
}
