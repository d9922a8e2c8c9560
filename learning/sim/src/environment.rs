//! The simulated tabletop for closed-loop control: a goal, pictures, actions, and whether the goal is attained.
//!
//! Room, camera and objects are those of the recorded [`Episode`](crate::Episode) of the same seed; the goal is drawn from
//! that seed too. A goal is accepted only if the oracle, a controller with the true state, attains it without moving other
//! objects, and if the camera sees the object to move, before and after.

mod choice;
mod demonstration;
mod goal;
mod oracle;
mod performance;
mod policy;
mod sight;
mod solution;

pub(crate) use demonstration::Demonstration;
pub use goal::{Goal, GoalKind, REACH_TOLERANCE_M, Target};
pub use performance::Performance;
pub use policy::ScriptedPolicy;

use image::RgbImage;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::num::NonZeroUsize;

use crate::arm::{self, ToolPose};
use crate::error::Error;
use crate::gripper::HALF_OPENING_M;
use crate::layout;
use crate::render::{Camera, Renderer, Surroundings};
use crate::room;
use crate::scene::Scene;
use crate::teleop::{LARGEST_STEP_M, LARGEST_TURN_RAD, Task};
use crate::variety::Variety;
use crate::world::{EndEffectorAction, STEP_S, World};
use sight::share_in_sight;
use solution::Solution;

/// Limit of tables per seed until one allows a goal, and of goals tried on each.
const TABLES: usize = 40;
const GOALS_PER_TABLE: usize = 40;
/// Minimum visible share of the object to move, at the start and at the goal: otherwise the pictures do not show the task.
const LEAST_IN_SIGHT: f64 = 0.3;
/// First random stream of goals, one per kind; operators use the earlier ones.
const FIRST_STREAM: u64 = 64;

/// Names of the arm's joints and fingers (Interbotix's `wx250s`), in the order of [`Environment::joint_positions`].
pub const JOINT_NAMES: [&str; 8] = [
    "waist",
    "shoulder",
    "elbow",
    "forearm_roll",
    "wrist_angle",
    "wrist_rotate",
    "left_finger",
    "right_finger",
];

/// Joint positions in the order of [`JOINT_NAMES`], for a tool and an opening; see [`Environment::joint_positions`].
pub(crate) fn joint_positions(tool: &ToolPose, opening: f64) -> Option<[f64; 8]> {
    let [waist, shoulder, elbow, roll, wrist, rotate] = arm::inverse(&tool.frame())?.0;
    let finger = opening * HALF_OPENING_M;
    Some([waist, shoulder, elbow, roll, wrist, rotate, finger, -finger])
}

/// A real or simulated state, and its picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// Number of actions up to it.
    pub step: usize,
    /// The state.
    pub world: World,
    /// The camera's picture, 256 by 256.
    pub picture: RgbImage,
}

/// A tabletop with a goal, which actions change step by step, 0.2 s each.
///
/// ```
/// use wm_sim::{Environment, GoalKind, Variety};
///
/// # fn main() -> Result<(), wm_sim::Error> {
/// let mut environment = Environment::new(GoalKind::Push, 7, &Variety::default())?;
/// println!("{}", environment.goal().instruction);
/// while !environment.solved() {
///     // A policy would look at environment.picture() and environment.goal().picture.
///     let action = environment.oracle();
///     environment.step(&action)?;
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
pub struct Environment {
    kind: GoalKind,
    seed: u64,
    world: World,
    steps: usize,
    goal: Goal,
    task: Task,
    solution: Solution,
    scene: Scene,
    surroundings: Surroundings,
    camera: Camera,
    renderer: Renderer,
}

impl Environment {
    /// The environment of a seed; the same kind, seed and variety give the same one. Room and camera, and the table if it
    /// allows a goal of this kind, are those of the recorded episode of this seed: test models on seeds that were not in their
    /// training data.
    ///
    /// # Errors
    /// [`Error::Unsolvable`] if none of 40 tables allows a goal of this kind.
    pub fn new(kind: GoalKind, seed: u64, variety: &Variety) -> Result<Self, Error> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let surroundings = room::draw_surroundings(variety, &mut rng);
        let camera = room::draw_camera(variety, &mut rng);
        let viewer = camera.viewer_axes().map(|axis| axis.cast());
        let mut goals = ChaCha8Rng::seed_from_u64(seed);
        goals.set_stream(FIRST_STREAM + kind as u64);
        let mut renderer = Renderer::new(&surroundings, camera.clone());
        let found = (0..TABLES).find_map(|_| {
            let world = layout::lay_table(variety, &mut rng);
            let scene = Scene::new(&world);
            let (target, task, solution) = (0..GOALS_PER_TABLE).find_map(|_| {
                let (target, task) = choice::draw(kind, &world, viewer, &mut goals)?;
                let solution = Solution::of(&target, &world)?;
                let in_sight = target.object().is_none_or(|object| {
                    [&world, solution.end()].into_iter().all(|world| {
                        share_in_sight(&mut renderer, &scene, world, object) >= LEAST_IN_SIGHT
                    })
                });
                in_sight.then_some((target, task, solution))
            })?;
            Some((world, scene, target, task, solution))
        });
        let (world, scene, target, task, solution) = found.ok_or(Error::Unsolvable {
            kind: kind.name(),
            seed,
            tables: TABLES,
        })?;
        let end = solution.end().clone();
        let picture = renderer.render(&scene.parts(&end), false).rgb;
        Ok(Self {
            kind,
            seed,
            steps: 0,
            goal: Goal {
                target,
                instruction: task.instruction(&world),
                world: end,
                picture,
            },
            task,
            world,
            solution,
            scene,
            surroundings,
            camera,
            renderer,
        })
    }

    /// The kind of goal.
    pub fn kind(&self) -> GoalKind {
        self.kind
    }

    /// The seed.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The goal.
    pub fn goal(&self) -> &Goal {
        &self.goal
    }

    /// The task in English.
    pub fn instruction(&self) -> &str {
        &self.goal.instruction
    }

    /// The present state: tool pose, gripper opening, objects. A clone is cheap: [`World::step`] on it predicts an action
    /// without a picture.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Number of actions so far.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Time since the start, seconds.
    pub fn time_s(&self) -> f64 {
        // Exact: far below 2^53.
        self.steps as f64 * STEP_S
    }

    /// Remaining distance to the goal, metres; see [`Target::distance_m`].
    pub fn distance_m(&self) -> f64 {
        self.goal.target.distance_m(&self.world)
    }

    /// Whether the goal is attained now; see [`Target::met_by`]. It may be lost again.
    pub fn solved(&self) -> bool {
        self.goal.target.met_by(&self.world)
    }

    /// Whether the instruction is fulfilled now; see `Task::succeeded`. Words demand less than the goal: they name no exact
    /// place.
    pub fn instruction_followed(&self) -> bool {
        self.task.succeeded(&self.world)
    }

    /// Angles of the six joints, radians, and distances of the two fingers from the hand's middle, metres (the right one
    /// negative, as in `wx250s`), in the order of [`JOINT_NAMES`]. `None` out of reach, which no action causes.
    ///
    pub fn joint_positions(&self) -> Option<[f64; 8]> {
        joint_positions(self.world.tool(), self.world.opening())
    }

    /// Executes an action and returns the exact motion of the tool. Limits the action to [`LARGEST_STEP_M`] along an axis,
    /// [`LARGEST_TURN_RAD`] about one and a gripper from 0 to 1; workspace, reach and contacts limit it further.
    ///
    ///
    /// # Errors
    /// [`Error::Action`] if a value is not finite; the state does not change.
    pub fn step(&mut self, action: &EndEffectorAction) -> Result<EndEffectorAction, Error> {
        let command = limit_action(action)?;
        self.steps += 1;
        Ok(self.world.step(&command))
    }

    /// Returns to the start.
    pub fn reset(&mut self) {
        self.world = self.solution.start().clone();
        self.steps = 0;
    }

    /// The camera's present picture, 256 by 256.
    pub fn picture(&mut self) -> RgbImage {
        let parts = self.scene.parts(&self.world);
        self.renderer.render(&parts, false).rgb
    }

    /// The camera's picture of another state of this table, 256 by 256.
    pub fn picture_of(&mut self, world: &World) -> RgbImage {
        self.renderer.render(&self.scene.parts(world), false).rgb
    }

    /// The room without the arm and the objects.
    pub(crate) fn surroundings(&self) -> &Surroundings {
        &self.surroundings
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// A renderer of this room for another camera, for [`Environment::picture_by`].
    pub fn renderer(&self, camera: Camera) -> Renderer {
        Renderer::new(&self.surroundings, camera)
    }

    /// Another camera's present picture, 256 by 256.
    pub fn picture_by(&self, renderer: &mut Renderer) -> RgbImage {
        renderer.render(&self.scene.parts(&self.world), false).rgb
    }

    /// Predicts `actions` from the present state, with the limits of [`Environment::step`]: state and picture after each. The
    /// environment does not change.
    ///
    /// # Errors
    /// [`Error::Action`] if a value is not finite.
    pub fn imagine(&mut self, actions: &[EndEffectorAction]) -> Result<Vec<Snapshot>, Error> {
        let mut world = self.world.clone();
        let first = self.steps + 1;
        (first..)
            .zip(actions)
            .map(|(step, action)| {
                world.step(&limit_action(action)?);
                Ok(Snapshot {
                    step,
                    world: world.clone(),
                    picture: self.picture_of(&world),
                })
            })
            .collect()
    }

    /// The oracle's next action towards the goal, by the true state and without noise, from any state. It moves at most 0.04 m
    /// per action, and holds still when it is done.
    ///
    pub fn oracle(&self) -> EndEffectorAction {
        self.oracle_for(&self.goal.target)
    }

    /// The oracle's next action for another target: a perfect controller with the wrong task.
    pub fn oracle_for(&self, target: &Target) -> EndEffectorAction {
        oracle::command(target, &self.world).unwrap_or_else(|| oracle::at_rest(&self.world))
    }

    /// The oracle's actions from the start to the goal; [`Environment::step`] reproduces them exactly.
    pub fn solution(&self) -> &[EndEffectorAction] {
        self.solution.actions()
    }

    /// States and pictures along the solution: after every `every` actions, and at its end.
    pub fn subgoals(&mut self, every: NonZeroUsize) -> Vec<Snapshot> {
        let last = self.solution.actions().len();
        let steps = (every.get()..last).step_by(every.get());
        steps
            .chain([last])
            .map(|step| {
                let world = self.solution.after(step).clone();
                Snapshot {
                    step,
                    picture: self.picture_of(&world),
                    world,
                }
            })
            .collect()
    }
}

fn limit_action(action: &EndEffectorAction) -> Result<EndEffectorAction, Error> {
    let values = action.translation.iter().chain(action.rotation.iter());
    if !values
        .chain([&action.gripper])
        .all(|value| value.is_finite())
    {
        return Err(Error::Action { action: *action });
    }
    Ok(within_limits(action))
}

/// The action, limited to the largest step, turn and opening.
fn within_limits(action: &EndEffectorAction) -> EndEffectorAction {
    EndEffectorAction {
        translation: action
            .translation
            .map(|v| v.clamp(-LARGEST_STEP_M, LARGEST_STEP_M)),
        rotation: action
            .rotation
            .map(|v| v.clamp(-LARGEST_TURN_RAD, LARGEST_TURN_RAD)),
        gripper: action.gripper.clamp(0.0, 1.0),
    }
}

#[cfg(test)]
mod tests;
