//! The simulated arm without DDS and without a clock.

use std::{num::NonZeroUsize, time::Duration};

use image::RgbImage;
use nalgebra::Vector3;
use thiserror::Error;
use wm_msgs::{
    geometry_msgs::TwistStamped,
    std_msgs::{Float64, Float64MultiArray},
    wm_msgs::Action,
};
use wm_sim::{
    EndEffectorAction, Environment, GoalKind, LARGEST_STEP_M, LARGEST_TURN_RAD, STEP_S, Target,
    ToolPose, Variety, World, render,
};

use crate::{displacement::Displacement, executor::Velocity};

use super::{
    camera::{Camera, CameraSettings, Frame, View},
    command::{self, CommandError, Motion, VelocityCommand},
};

/// Rounding error of the largest motion of a step in the single precision of actions \[m or rad\].
const ROUNDING: f64 = 1e-6;

/// Settings of the arm.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The task.
    pub task: GoalKind,
    /// Seed of the table, the goal and the camera.
    pub seed: u64,
    /// A commanded motion holds for this long after its reception.
    pub command_timeout: Duration,
    /// The only frame that commands may name; empty: any.
    pub base_frame: String,
    /// Steps of the solution between two pictures of the goal; `None`: the goal is the last picture alone.
    pub goal_every: Option<NonZeroUsize>,
    /// The cameras' faults.
    pub camera: CameraSettings,
    /// Whether there is a second camera.
    pub has_front_camera: bool,
}

/// The reason why a command is executed in part or not at all.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum Problem {
    /// The motion is larger than the largest of a step.
    #[error(
        "commanded to move {} m and turn {} rad in {STEP_S} s; at most {LARGEST_STEP_M:.4} m along an axis and \
         {LARGEST_TURN_RAD:.4} rad about one are done", axes(.translation), axes(.rotation)
    )]
    Limited {
        /// Translation along x, y and z \[m\].
        translation: [f64; 3],
        /// Roll, pitch and yaw \[rad\].
        rotation: [f64; 3],
    },
    /// A motion waited for longer than `command_timeout`.
    #[error("a motion waited for {waited_s:.2} s, longer than command_timeout, and is not done")]
    Stale {
        /// Time since its reception \[s\].
        waited_s: f64,
    },
    /// The simulator refused the motion.
    #[error("{0}")]
    Refused(String),
}

fn axes([x, y, z]: &[f64; 3]) -> String {
    format!("({x:.3}, {y:.3}, {z:.3})")
}

impl Problem {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Limited { .. } => "out_of_bounds",
            Self::Stale { .. } => "stale",
            Self::Refused(_) => "not_finite",
        }
    }
}

/// The motion of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepMotion {
    /// The start of the step \[ns\]: the stamp of the previous picture.
    pub stamp_ns: i64,
    /// The motion of the tool, and the commanded opening of the gripper.
    pub action: EndEffectorAction,
}

/// The result of a step, to publish.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// The time of this result \[ns\].
    pub stamp_ns: i64,
    /// The pose of the tool.
    pub tool: ToolPose,
    /// The opening of the gripper, 0 closed to 1 open.
    pub opening: f64,
    /// Positions in the order of [`wm_sim::JOINT_NAMES`] \[rad or m\].
    pub joints: Option<[f64; 8]>,
    /// Distance to the goal \[m\].
    pub distance_m: f64,
    /// Whether the task is done; `None` if that has not changed.
    pub success: Option<bool>,
    /// The motion of the step; `None` at the start, and after a reset or a jump of the clock.
    pub done: Option<StepMotion>,
    /// The reason why the command was not executed as a whole.
    pub problem: Option<Problem>,
    /// The pictures that arrive now.
    pub frames: Vec<Frame>,
    /// Number of lost pictures of this step.
    pub lost_pictures: u64,
}

/// The second camera.
struct Front {
    eye: render::Camera,
    renderer: render::Renderer,
    camera: Camera,
}

/// A simulated arm on a table, with cameras.
pub struct SimArmStep {
    settings: Settings,
    environment: Environment,
    /// Pictures on the way to the goal; the last one is the goal.
    goals: Vec<RgbImage>,
    camera: Camera,
    front: Option<Box<Front>>,
    /// The commanded motion, and the time of the last command \[ns\].
    motion: Option<(Motion, i64)>,
    /// The commanded opening of the gripper.
    gripper: f64,
    /// The time of the last tick \[ns\].
    last_ns: Option<i64>,
    /// The last [`Tick::success`].
    last_success: Option<bool>,
}

impl SimArmStep {
    /// The arm at the start of its task.
    ///
    /// # Errors
    /// [`wm_sim::Error::Unsolvable`]: with this seed the task has no solution.
    pub fn new(settings: Settings) -> Result<Self, wm_sim::Error> {
        let mut environment = Environment::new(settings.task, settings.seed, &Variety::default())?;
        let goals = match settings.goal_every {
            Some(every) => {
                let subgoals = environment.subgoals(every).into_iter();
                subgoals.map(|subgoal| subgoal.picture).collect()
            }
            None => vec![environment.goal().picture.clone()],
        };
        let camera = |view| Camera::new(view, settings.camera, settings.seed);
        let front = settings.has_front_camera.then(|| {
            let eye = render::Camera::facing_the_arm();
            Box::new(Front {
                renderer: environment.renderer(eye.clone()),
                eye,
                camera: camera(View::Front),
            })
        });
        Ok(Self {
            goals,
            camera: camera(View::Side),
            front,
            motion: None,
            gripper: environment.world().opening(),
            last_ns: None,
            last_success: None,
            environment,
            settings,
        })
    }

    /// The settings, with the task and the seed of the last reset.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The task in English.
    pub fn instruction(&self) -> &str {
        self.environment.instruction()
    }

    /// The picture of the camera once the task is done.
    pub fn goal_picture(&self) -> &RgbImage {
        &self.environment.goal().picture
    }

    /// Pictures of the camera on the way to the goal, in order. The last one is [`Self::goal_picture`].
    pub fn goals(&self) -> &[RgbImage] {
        &self.goals
    }

    /// The target of the task.
    pub fn target(&self) -> &Target {
        &self.environment.goal().target
    }

    /// The cameras with their geometry.
    pub fn eyes(&self) -> impl Iterator<Item = (View, &render::Camera)> {
        let front = self.front.as_ref().map(|front| (View::Front, &front.eye));
        std::iter::once((View::Side, self.environment.camera())).chain(front)
    }

    /// The state of the table.
    pub fn world(&self) -> &World {
        self.environment.world()
    }

    /// Starts the task anew, exactly as [`Self::new`] with this seed. Earlier commands are dropped.
    ///
    /// # Errors
    /// [`wm_sim::Error::Unsolvable`]: with this seed the task has no solution. The arm stays as it is.
    pub fn reset(&mut self, task: GoalKind, seed: u64) -> Result<(), wm_sim::Error> {
        let settings = Settings {
            task,
            seed,
            ..self.settings.clone()
        };
        *self = Self::new(settings)?;
        Ok(())
    }

    /// Takes a velocity, which holds until the next command, at most for `command_timeout`. Several velocities in a
    /// step each count for their time.
    ///
    /// # Errors
    /// [`CommandError`]: it is refused, and the previous command still holds.
    pub fn twist(&mut self, twist: &TwistStamped, received_ns: i64) -> Result<(), CommandError> {
        let velocity = command::of_twist(twist, &self.settings.base_frame)?;
        self.hold(velocity, received_ns);
        Ok(())
    }

    /// Takes a velocity as six numbers.
    ///
    /// # Errors
    /// See [`Self::twist`].
    pub fn velocity(
        &mut self,
        array: &Float64MultiArray,
        received_ns: i64,
    ) -> Result<(), CommandError> {
        self.hold(command::of_array(array)?, received_ns);
        Ok(())
    }

    fn hold(&mut self, velocity: Velocity, received_ns: i64) {
        let command = match self.motion {
            Some((Motion::Velocity(earlier), _)) => earlier.then(velocity, received_ns),
            _ => VelocityCommand::new(velocity, received_ns),
        };
        self.motion = Some((Motion::Velocity(command), received_ns));
    }

    /// Takes a motion for the next step, and the gripper's opening. Motions between two ticks add up: the executor
    /// publishes several in a step.
    ///
    /// # Errors
    /// See [`Self::twist`].
    pub fn action(&mut self, action: &Action, received_ns: i64) -> Result<(), CommandError> {
        let (next, gripper) = command::of_action(action, &self.settings.base_frame)?;
        let delta = match self.motion {
            Some((Motion::Delta(before), _)) => before.then(next),
            _ => next,
        };
        self.motion = Some((Motion::Delta(delta), received_ns));
        self.gripper = gripper.clamp(0.0, 1.0);
        Ok(())
    }

    /// Takes an opening of the gripper, 0 closed to 1 open. It holds until the next one.
    ///
    /// # Errors
    /// See [`Self::twist`].
    pub fn gripper(&mut self, opening: &Float64) -> Result<(), CommandError> {
        self.gripper = command::of_gripper(opening)?.clamp(0.0, 1.0);
        Ok(())
    }

    /// Computes one step of the simulator, 0.2 s, and takes a picture. The first tick only takes a picture.
    pub fn tick(&mut self, now_ns: i64) -> Tick {
        let mut problem = None;
        let done = self.last_ns.map(|stamp_ns| {
            let command;
            (command, problem) = self.command(stamp_ns, now_ns);
            let action = self.environment.step(&command).unwrap_or_else(|refused| {
                problem = Some(Problem::Refused(refused.to_string()));
                self.motion = None;
                EndEffectorAction::still(self.gripper)
            });
            StepMotion { stamp_ns, action }
        });
        self.last_ns = Some(now_ns);
        if let Some((Motion::Velocity(command), _)) = &mut self.motion {
            *command = command.from(now_ns);
        }
        let picture = self.environment.picture();
        let mut lost_pictures = u64::from(!self.camera.take(picture, now_ns));
        if let Some(front) = &mut self.front {
            let picture = self.environment.picture_by(&mut front.renderer);
            lost_pictures += u64::from(!front.camera.take(picture, now_ns));
        }
        let is_solved = self.environment.solved();
        let success = (self.last_success != Some(is_solved)).then_some(is_solved);
        self.last_success = Some(is_solved);
        let frames = self.frames(now_ns);
        let world = self.environment.world();
        Tick {
            stamp_ns: now_ns,
            tool: *world.tool(),
            opening: world.opening(),
            joints: self.environment.joint_positions(),
            distance_m: self.environment.distance_m(),
            success,
            done,
            problem,
            frames,
            lost_pictures,
        }
    }

    /// The time when the next picture arrives \[ns\]; `None` if none is expected.
    pub fn next_frame_ns(&self) -> Option<i64> {
        let front = self.front.as_ref().and_then(|front| front.camera.next_ns());
        self.camera.next_ns().into_iter().chain(front).min()
    }

    /// Removes and returns the pictures that arrive by `now_ns`.
    pub fn frames(&mut self, now_ns: i64) -> Vec<Frame> {
        let mut frames = self.camera.arrived(now_ns);
        if let Some(front) = &mut self.front {
            frames.extend(front.camera.arrived(now_ns));
        }
        frames
    }

    /// Drops commands and pictures of the old time after a jump of the clock; returns the number of pictures.
    pub fn forget(&mut self) -> usize {
        self.motion = None;
        self.last_ns = None;
        let front = self.front.as_mut().map_or(0, |front| front.camera.forget());
        self.camera.forget() + front
    }

    /// The command of the step that began at `start_ns`.
    fn command(&mut self, start_ns: i64, now_ns: i64) -> (EndEffectorAction, Option<Problem>) {
        let still = EndEffectorAction::still(self.gripper);
        let Some((motion, command_ns)) = self.motion else {
            return (still, None);
        };
        let age = u64::try_from(now_ns.saturating_sub(command_ns)).map(Duration::from_nanos);
        let is_fresh = age.is_ok_and(|age| age <= self.settings.command_timeout);
        if !is_fresh || matches!(motion, Motion::Delta(_)) {
            self.motion = None;
        }
        let delta = match motion {
            // The client is silent, so the arm stands still.
            Motion::Velocity(_) if !is_fresh => return (still, None),
            Motion::Delta(_) if !is_fresh => {
                let waited_s = now_ns.saturating_sub(command_ns) as f64 / 1e9;
                return (still, Some(Problem::Stale { waited_s }));
            }
            // The simulator steps by 0.2 s, also if the tick is late.
            Motion::Velocity(command) => {
                Displacement::of_velocity(command.mean(start_ns, now_ns), STEP_S)
            }
            Motion::Delta(delta) => delta,
        };
        let (translation, rotation) = (delta.translation, delta.rotation());
        let is_beyond = largest(&translation) > LARGEST_STEP_M + ROUNDING
            || largest(&rotation) > LARGEST_TURN_RAD + ROUNDING;
        let problem = is_beyond.then(|| Problem::Limited {
            translation: translation.into(),
            rotation: rotation.into(),
        });
        let command = EndEffectorAction {
            translation,
            rotation,
            gripper: self.gripper,
        };
        (command, problem)
    }
}

/// The greatest magnitude.
fn largest(values: &Vector3<f64>) -> f64 {
    values.amax()
}

#[cfg(test)]
mod tests;
