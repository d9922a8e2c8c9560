//! The simulated tabletop step by step, for closed-loop control: a goal, pictures, actions, and whether the
//! goal is attained.
//!
//! The room, the camera and the objects are drawn as those of a recorded [`Episode`](crate::Episode), the
//! goal from the same seed. A goal is only set if a controller that sees the true state, the oracle, attains
//! it without moving any other object, and if the camera sees the object that is to move, before and after.

mod choice;
mod goal;
mod oracle;
mod sight;
mod solution;

pub use goal::{Goal, GoalKind, PLACE_TOLERANCE_M, REACH_TOLERANCE_M, Target};

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

/// How many tables are laid for a seed until one allows a goal, and how many goals are tried on each.
const TABLES: usize = 40;
const GOALS_PER_TABLE: usize = 40;
/// Share of the object to move that the camera sees at the start and at the goal at least: else the pictures
/// would not say what to do.
const LEAST_IN_SIGHT: f64 = 0.3;
/// Goals have a stream of their own for each kind, from this one on: operators have the first ones.
const FIRST_STREAM: u64 = 64;

/// The arm's joints and fingers by the names of Interbotix's `wx250s`, in the order of
/// [`Environment::joint_positions`].
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

/// Where the joints are, in the order of [`JOINT_NAMES`], for a tool and an opening; see
/// [`Environment::joint_positions`].
pub(crate) fn joint_positions(tool: &ToolPose, opening: f64) -> Option<[f64; 8]> {
    let [waist, shoulder, elbow, roll, wrist, rotate] = arm::inverse(&tool.frame())?.0;
    let finger = opening * HALF_OPENING_M;
    Some([waist, shoulder, elbow, roll, wrist, rotate, finger, -finger])
}

/// A state that is, was or would be, and what the camera sees of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// How many actions lead to it.
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
    /// The environment of a seed: the same kind, seed and variety give the same one. Its room and camera, and
    /// its table where that allows a goal of this kind, are those of the recorded episode of this seed; a
    /// model is tested on seeds that it was not trained on.
    ///
    /// # Errors
    /// [`Error::Unsolvable`] if no goal of this kind can be attained on any of 40 tables. With the default
    /// variety that has not been seen.
    pub fn new(kind: GoalKind, seed: u64, variety: &Variety) -> Result<Self, Error> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let surroundings = room::surroundings(variety, &mut rng);
        let camera = room::camera(variety, &mut rng);
        let viewer = camera.viewer_axes().map(|axis| axis.cast());
        let mut goals = ChaCha8Rng::seed_from_u64(seed);
        goals.set_stream(FIRST_STREAM + kind as u64);
        let mut renderer = Renderer::new(&surroundings, camera.clone());
        let found = (0..TABLES).find_map(|_| {
            let world = layout::world(variety, &mut rng);
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
            kind,
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

    /// What kind of goal it sets.
    pub fn kind(&self) -> GoalKind {
        self.kind
    }

    /// The seed that it came from.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// What is to come about.
    pub fn goal(&self) -> &Goal {
        &self.goal
    }

    /// The task in English.
    pub fn instruction(&self) -> &str {
        &self.goal.instruction
    }

    /// The present state: the tool's pose, the gripper's opening, the objects. A clone of it is cheap, and
    /// [`World::step`] on the clone tells what an action would do where no picture is needed.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// How many actions have been taken.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Time since the start, seconds.
    pub fn time_s(&self) -> f64 {
        // Numbers of actions are far below 2^53.
        self.steps as f64 * STEP_S
    }

    /// What is still missing, metres; see [`Target::distance_m`].
    pub fn distance_m(&self) -> f64 {
        self.goal.target.distance_m(&self.world)
    }

    /// Whether the goal is attained now; see [`Target::met_by`]. It may be lost again.
    pub fn solved(&self) -> bool {
        self.goal.target.met_by(&self.world)
    }

    /// Whether things stand now as the instruction asks; see [`Task::succeeded`]. Words ask for less than the goal:
    /// they name no exact place.
    pub fn instruction_followed(&self) -> bool {
        self.task.succeeded(&self.world)
    }

    /// The angles of the six joints, radians, and how far the two fingers are from the hand's middle, metres,
    /// the right one's negative as in `wx250s`, in the order of [`JOINT_NAMES`]. `None` if the tool is out of
    /// the arm's reach, where no action brings it.
    pub fn joint_positions(&self) -> Option<[f64; 8]> {
        joint_positions(self.world.tool(), self.world.opening())
    }

    /// Takes an action and returns what was possible of it: exactly the motion of the tool. What goes beyond
    /// [`LARGEST_STEP_M`] along an axis, [`LARGEST_TURN_RAD`] about one or a gripper from 0 to 1 is cut off
    /// before, and the workspace, the arm's reach and contacts take their part.
    ///
    /// # Errors
    /// [`Error::Action`] if a value is not finite; nothing moves then.
    pub fn step(&mut self, action: &EndEffectorAction) -> Result<EndEffectorAction, Error> {
        let command = bounded(action)?;
        self.steps += 1;
        Ok(self.world.step(&command))
    }

    /// Back to the start.
    pub fn reset(&mut self) {
        self.world = self.solution.start().clone();
        self.steps = 0;
    }

    /// What the camera sees now, 256 by 256.
    pub fn picture(&mut self) -> RgbImage {
        let parts = self.scene.parts(&self.world);
        self.renderer.render(&parts, false).rgb
    }

    /// What the camera would see of a state of this table, 256 by 256.
    pub fn picture_of(&mut self, world: &World) -> RgbImage {
        self.renderer.render(&self.scene.parts(world), false).rgb
    }

    /// The camera that the pictures are of.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// What draws this room as another camera sees it, for [`Environment::picture_by`].
    pub fn renderer(&self, camera: Camera) -> Renderer {
        Renderer::new(&self.surroundings, camera)
    }

    /// What another camera sees now, 256 by 256.
    pub fn picture_by(&self, renderer: &mut Renderer) -> RgbImage {
        renderer.render(&self.scene.parts(&self.world), false).rgb
    }

    /// What would come of `actions` from now on, taken as [`Environment::step`] takes them: the state and the
    /// picture after each. The environment stays as it is.
    ///
    /// # Errors
    /// [`Error::Action`] if a value is not finite.
    pub fn imagine(&mut self, actions: &[EndEffectorAction]) -> Result<Vec<Snapshot>, Error> {
        let mut world = self.world.clone();
        let first = self.steps + 1;
        (first..)
            .zip(actions)
            .map(|(step, action)| {
                world.step(&bounded(action)?);
                Ok(Snapshot {
                    step,
                    world: world.clone(),
                    picture: self.picture_of(&world),
                })
            })
            .collect()
    }

    /// What the oracle does now: the next action towards the goal by the true state, without noise, from
    /// wherever things are. It moves 0.04 m an action at most. Once there is nothing more to do, it holds
    /// still.
    pub fn oracle(&self) -> EndEffectorAction {
        self.oracle_for(&self.goal.target)
    }

    /// What the oracle would do now if `target` were the goal: a controller that is right about everything but
    /// what it is to do.
    pub fn oracle_for(&self, target: &Target) -> EndEffectorAction {
        oracle::command(target, &self.world).unwrap_or_else(|| oracle::at_rest(&self.world))
    }

    /// The oracle's actions from the start to the goal; [`Environment::step`] repeats them exactly.
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

/// The action within what one action can be.
fn bounded(action: &EndEffectorAction) -> Result<EndEffectorAction, Error> {
    let values = action.translation.iter().chain(action.rotation.iter());
    if !values
        .chain([&action.gripper])
        .all(|value| value.is_finite())
    {
        return Err(Error::Action { action: *action });
    }
    Ok(EndEffectorAction {
        translation: action
            .translation
            .map(|v| v.clamp(-LARGEST_STEP_M, LARGEST_STEP_M)),
        rotation: action
            .rotation
            .map(|v| v.clamp(-LARGEST_TURN_RAD, LARGEST_TURN_RAD)),
        gripper: action.gripper.clamp(0.0, 1.0),
    })
}

#[cfg(test)]
mod tests;
