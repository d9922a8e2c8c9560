//! A scripted teleoperator: chooses tasks and moves to sub-goals with a human's lag, pauses and tremor.
//!
//! The noise is part of the executed command, so that actions explain motion.

mod failure;
mod gesture;
mod plan;
mod task;

pub use failure::Failure;
pub(crate) use plan::{DIRECTIONS, grasp_level, is_burdened, is_graspable, is_inside};
pub(crate) use task::LEVEL_M;
pub use task::{Relation, Task};

use nalgebra::Vector3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, UnitSphere};
use std::collections::VecDeque;

use crate::world::{EndEffectorAction, LARGEST_RPY, WORKSPACE_M, World};
use gesture::Gesture;
use plan::{Aim, Move};

/// Largest change along one axis in one action, metres: the limit of Bridge's usual scaling (35 per metre, clipped at 1.74).
pub const LARGEST_STEP_M: f64 = 1.74 / 35.0;
/// Largest change of roll, pitch or yaw in one action, radians: 1.39 / 5.6, from the same scaling.
pub const LARGEST_TURN_RAD: f64 = 1.39 / 5.6;
/// Actions after which a sub-goal is abandoned.
const PATIENCE: usize = 14;
/// Minimum height of the hand after the last task, clear of all objects, metres.
pub(crate) const CLEAR_M: f64 = 0.095;
/// Distance from a sub-goal within which the hand makes no gestures, metres.
const GESTURE_DISTANCE_M: f64 = 0.035;
/// Number of remaining frames below which no task starts and the operator drifts.
const LEAST_FRAMES_FOR_A_TASK: usize = 16;

/// An operator's work in an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Assignment {
    /// Free motion.
    Exploration,
    /// One task after another.
    Tasks,
    /// One task, with a failure if one is given.
    OneTask(Option<Failure>),
}

/// One operator over one episode.
pub struct Operator {
    rng: ChaCha8Rng,
    /// Horizontal unit vectors to the viewer's right and away from the viewer.
    viewer: [Vector3<f64>; 2],
    moves: VecDeque<Move>,
    tasks: Vec<Task>,
    /// Whether each finished task succeeded.
    outcomes: Vec<bool>,
    /// Top speed, metres per action.
    speed: f64,
    /// Standard deviations of the tremor: metres and radians per action.
    tremor: [f64; 2],
    velocity: Vector3<f64>,
    turning: Vector3<f64>,
    shake: [Vector3<f64>; 2],
    pause: usize,
    spent: usize,
    gripper: f64,
    drift: Drift,
    gesture: Gesture,
    /// Whether the whole episode is free motion.
    explores: bool,
    assignment: Assignment,
    /// Whether the operator has stopped for good.
    halted: bool,
    /// Maximum height of free motion, metres: low enough in many episodes to touch objects.
    ceiling_m: f64,
}

#[derive(Default)]
struct Drift {
    velocity: Vector3<f64>,
    turning: Vector3<f64>,
    frames: usize,
}

impl Operator {
    /// An operator whose view of the table is along `viewer` (unit vectors to the right and ahead).
    pub fn new(
        mut rng: ChaCha8Rng,
        viewer: [Vector3<f64>; 2],
        world: &World,
        assignment: Assignment,
    ) -> Self {
        let explores = assignment == Assignment::Exploration;
        let ceiling_m = if rng.random_bool(0.5) {
            0.07
        } else {
            WORKSPACE_M[1][2]
        };
        let speed = rng.random_range(0.026..0.047);
        let tremor = [
            rng.random_range(0.0015..0.004),
            rng.random_range(0.015..0.05),
        ];
        let mut operator = Self {
            rng,
            viewer,
            moves: VecDeque::new(),
            tasks: Vec::new(),
            outcomes: Vec::new(),
            speed,
            tremor,
            velocity: Vector3::zeros(),
            turning: Vector3::zeros(),
            shake: [Vector3::zeros(); 2],
            pause: 0,
            spent: 0,
            gripper: if world.opening() > 0.5 { 1.0 } else { 0.0 },
            drift: Drift::default(),
            gesture: Gesture::default(),
            explores,
            assignment,
            halted: false,
            ceiling_m,
        };
        if explores {
            operator.tasks.push(Task::Explore);
        }
        operator
    }

    /// The next command, with `left` frames left in the episode.
    pub fn command(&mut self, world: &World, left: usize) -> EndEffectorAction {
        if self.moves.is_empty() {
            self.next_task(world, left);
        }
        if self.pause == 0 && self.rng.random_bool(0.05) {
            self.pause = self.rng.random_range(1..=3);
        }
        let (wanted, wanted_turn) = match self.moves.front().cloned() {
            None => self.drift(world),
            Some(Move::Drift { .. }) => self.drift(world),
            Some(Move::Grip { to, .. }) => {
                self.gripper = to;
                (Vector3::zeros(), Vector3::zeros())
            }
            Some(Move::Linger { .. }) => {
                let rpy = world.tool().rpy * 0.8;
                let gripper = if world.held().is_some() { 0.0 } else { 1.0 };
                let turn = self.add_gesture(world, rpy, gripper);
                (Vector3::zeros(), turn)
            }
            Some(Move::Go {
                aim,
                rpy,
                gripper,
                loose,
                ..
            }) => {
                let offset = aim.point(world) - world.tool().position;
                let speed = self.speed.min(offset.norm());
                let turn = if loose && offset.norm() > GESTURE_DISTANCE_M {
                    self.add_gesture(world, rpy, gripper)
                } else {
                    self.gripper = gripper;
                    turn_towards(rpy, world)
                };
                // Without a distance there is no direction, and no motion.
                (offset.try_normalize(1e-9).unwrap_or_default() * speed, turn)
            }
        };
        let free = self.explores || matches!(self.moves.front(), Some(Move::Drift { .. }));
        if self.pause > 0 && !free {
            self.pause -= 1;
            self.velocity *= 0.2;
            self.turning *= 0.2;
        } else {
            // The hand lags its intention by about one action.
            self.velocity = self.velocity * 0.35 + wanted * 0.65;
            self.turning = self.turning * 0.35 + wanted_turn * 0.65;
        }
        self.advance(world);
        self.add_tremor()
    }

    /// The instruction, and whether all of it succeeded: each task by the world at its end, the last one by the world at the
    /// end of the episode.
    pub fn conclude(mut self, world: &World) -> (String, bool) {
        if let Some(task) = self.tasks.last() {
            self.outcomes.truncate(self.tasks.len() - 1);
            self.outcomes.push(task.succeeded(world));
        }
        let sentences: Vec<_> = self
            .tasks
            .iter()
            .map(|task| task.instruction(world))
            .collect();
        (
            sentences.join(", then "),
            self.outcomes.iter().all(|success| *success),
        )
    }

    fn next_task(&mut self, world: &World, left: usize) {
        if self.explores {
            return;
        }
        if self.outcomes.len() < self.tasks.len()
            && let Some(task) = self.tasks.last()
        {
            self.outcomes.push(task.succeeded(world));
        }
        self.spent = 0;
        let one_task = matches!(self.assignment, Assignment::OneTask(_));
        if (left < LEAST_FRAMES_FOR_A_TASK || one_task)
            && let Some(task) = self.tasks.last()
        {
            // A held object stays held while the hand drifts, so that a lift counts.
            let stays = self.halted || matches!(task, Task::Reach { .. });
            self.moves.push_back(if stays {
                Move::Linger { frames: left }
            } else {
                Move::Drift { frames: left }
            });
            return;
        }
        if !self.tasks.is_empty()
            && let Some(moves) = plan::put_down(world)
        {
            self.moves.extend(moves);
            return;
        }
        let (task, moves) = self.plan(world);
        self.tasks.push(task);
        self.moves.extend(moves);
    }

    fn plan(&mut self, world: &World) -> (Task, Vec<Move>) {
        let first = self.tasks.is_empty();
        if let Assignment::OneTask(Some(failure)) = self.assignment {
            // Not every task allows every failure.
            for _ in 0..30 {
                let (task, moves) = plan::next(&mut self.rng, world, self.viewer, first);
                if let Some(plan) = failure.spoil(&mut self.rng, world, task, moves) {
                    self.halted = failure == Failure::Halted;
                    return plan;
                }
            }
        }
        plan::next(&mut self.rng, world, self.viewer, first)
    }

    /// The turn towards `rpy` with a gesture; sets the gripper.
    fn add_gesture(&mut self, world: &World, rpy: Vector3<f64>, gripper: f64) -> Vector3<f64> {
        let free = world.held().is_none();
        self.gesture.advance(&mut self.rng);
        self.gripper = if free && self.gesture.inverts_gripper() {
            1.0 - gripper
        } else {
            gripper
        };
        turn_towards(rpy + self.gesture.turn(), world)
    }

    /// Ends the present move when it is done or has taken too long.
    fn advance(&mut self, world: &World) {
        self.spent += 1;
        let done = match self.moves.front() {
            None => false,
            Some(Move::Drift { frames } | Move::Linger { frames } | Move::Grip { frames, .. }) => {
                self.spent >= *frames
            }
            Some(Move::Go {
                aim,
                rpy,
                tolerance_m,
                ..
            }) => {
                let near = (aim.point(world) - world.tool().position).norm() < *tolerance_m;
                let turned = (rpy - world.tool().rpy).amax() < 0.2;
                near && turned || self.spent >= PATIENCE
            }
        };
        if done {
            self.moves.pop_front();
            self.spent = 0;
        }
    }

    /// Free motion: velocity and turn last for a few frames, away from the limits.
    fn drift(&mut self, world: &World) -> (Vector3<f64>, Vector3<f64>) {
        if self.drift.frames == 0 {
            self.drift.frames = self.rng.random_range(2..=6);
            let direction: [f64; 3] = UnitSphere.sample(&mut self.rng);
            let speed = self.rng.random_range(0.008..0.05);
            self.drift.velocity = Vector3::from(direction) * speed;
            self.drift.turning = Vector3::from_fn(|_, _| {
                if self.rng.random_bool(0.65) {
                    self.rng.random_range(-0.22..0.22)
                } else {
                    0.0
                }
            });
            if self.rng.random_bool(0.45) {
                let keeps = world.held().is_some() && (!self.explores || self.rng.random_bool(0.6));
                self.gripper = if keeps {
                    0.0
                } else {
                    f64::from(u8::from(self.rng.random_bool(0.5)))
                };
            }
        }
        self.drift.frames -= 1;
        let [mut low, mut high] = WORKSPACE_M;
        if self.explores {
            high[2] = self.ceiling_m;
        } else {
            // Finished tasks must not be undone.
            low[2] = CLEAR_M;
        }
        for axis in 0..3 {
            let next = world.tool().position[axis] + 2.0 * self.drift.velocity[axis];
            if next < low[axis] {
                self.drift.velocity[axis] = self.drift.velocity[axis].abs();
            } else if next > high[axis] {
                self.drift.velocity[axis] = -self.drift.velocity[axis].abs();
            }
            let angle = world.tool().rpy[axis] + 2.0 * self.drift.turning[axis];
            if angle.abs() > LARGEST_RPY[axis] {
                self.drift.turning[axis] = -angle.signum() * self.drift.turning[axis].abs();
            }
        }
        (self.drift.velocity, self.drift.turning)
    }

    fn add_tremor(&mut self) -> EndEffectorAction {
        for (shake, deviation) in self.shake.iter_mut().zip(self.tremor) {
            // The distribution exists: deviations are positive and finite.
            if let Ok(normal) = Normal::new(0.0, deviation) {
                *shake = *shake * 0.5 + Vector3::from_fn(|_, _| normal.sample(&mut self.rng));
            }
        }
        let [shift, turn] = self.shake;
        let bound = |v: Vector3<f64>, limit: f64| v.map(|x| x.clamp(-limit, limit));
        EndEffectorAction {
            translation: bound(self.velocity + shift, LARGEST_STEP_M),
            rotation: bound(self.turning + turn, LARGEST_TURN_RAD),
            gripper: self.gripper,
        }
    }
}

/// The turn of one action from the hand's pose towards `rpy`, radians.
pub(crate) fn turn_towards(rpy: Vector3<f64>, world: &World) -> Vector3<f64> {
    (rpy - world.tool().rpy).map(|v| v.clamp(-LARGEST_TURN_RAD, LARGEST_TURN_RAD))
}

impl Aim {
    fn point(&self, world: &World) -> Vector3<f64> {
        let point = match *self {
            Self::Point(point) => point,
            Self::Object { index, offset } => world
                .objects()
                .get(index)
                .map_or(offset, |object| object.position() + offset),
        };
        let [low, high] = WORKSPACE_M;
        Vector3::from_fn(|axis, _| point[axis].clamp(low[axis] + 0.003, high[axis] - 0.003))
    }
}
