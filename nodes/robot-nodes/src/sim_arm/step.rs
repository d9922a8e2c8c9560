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
    command::{self, CommandError, Held, Motion},
};

/// Rounding of what is exactly the largest motion of a step, in the single precision of actions \[m or rad\].
const ROUNDING: f64 = 1e-6;

/// What the arm is and does.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// What is to be done.
    pub task: GoalKind,
    /// Of the table, the goal and the camera.
    pub seed: u64,
    /// How long a commanded motion holds after its reception.
    pub command_timeout: Duration,
    /// The frame that commands may name; empty: any.
    pub base_frame: String,
    /// The goal is told by a picture after each so many steps of the solution; `None`: by the last one alone.
    pub goal_every: Option<NonZeroUsize>,
    /// How good the cameras are.
    pub camera: CameraSettings,
    /// Whether there is a second camera.
    pub has_front_camera: bool,
}

/// Why the arm does not do all that it is told.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum Problem {
    /// More than one step of the simulator can be.
    #[error(
        "told to move {} m and turn {} rad in {STEP_S} s; at most {LARGEST_STEP_M:.4} m along an axis and \
         {LARGEST_TURN_RAD:.4} rad about one are done", axes(.translation), axes(.rotation)
    )]
    Limited {
        /// Along x, y and z \[m\].
        translation: [f64; 3],
        /// Roll, pitch and yaw \[rad\].
        rotation: [f64; 3],
    },
    /// A motion waited for longer than `command_timeout`.
    #[error("a motion waited for {waited_s:.2} s, longer than command_timeout, and is not done")]
    Stale {
        /// How long \[s\].
        waited_s: f64,
    },
    /// A motion that the simulator does not take.
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

/// What was done in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Done {
    /// When the step began \[ns\]: the stamp of the picture before.
    pub stamp_ns: i64,
    /// The motion of the tool, and where the gripper was told to go.
    pub action: EndEffectorAction,
}

/// What there is to publish after a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// The time of what follows \[ns\].
    pub stamp_ns: i64,
    /// Where the tool is.
    pub tool: ToolPose,
    /// How far the gripper is open, 0 to 1.
    pub opening: f64,
    /// By the names of [`wm_sim::JOINT_NAMES`] \[rad or m\].
    pub joints: Option<[f64; 8]>,
    /// What is missing to the goal \[m\].
    pub distance_m: f64,
    /// Whether the goal is attained, where that is new.
    pub success: Option<bool>,
    /// None at the start, and after a reset or a jump of the clock: no step led here.
    pub done: Option<Done>,
    /// Why less was done than was told.
    pub problem: Option<Problem>,
    /// The pictures that have arrived.
    pub frames: Vec<Frame>,
    /// How many pictures of this moment are lost.
    pub lost_pictures: u64,
}

/// The second camera: what it sees, and what becomes of it.
struct Front {
    eye: render::Camera,
    renderer: render::Renderer,
    camera: Camera,
}

/// A simulated arm on a table, with cameras.
pub struct SimArmStep {
    settings: Settings,
    environment: Environment,
    /// The way to the goal, and the goal.
    goals: Vec<RgbImage>,
    camera: Camera,
    front: Option<Box<Front>>,
    /// How the arm is to move, and when that was said last \[ns\].
    motion: Option<(Motion, i64)>,
    /// Where the gripper is to go.
    gripper: f64,
    /// When the tick before was \[ns\].
    last_ns: Option<i64>,
    /// What was said of the goal.
    told: Option<bool>,
}

impl SimArmStep {
    /// The arm at the start of its task.
    ///
    /// # Errors
    /// [`wm_sim::Error::Unsolvable`]: the seed has no such task.
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
            told: None,
            environment,
            settings,
        })
    }

    /// What it was made of, and the task and seed of the last reset.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The task in English.
    pub fn instruction(&self) -> &str {
        self.environment.instruction()
    }

    /// What the camera would see once the task is done.
    pub fn goal_picture(&self) -> &RgbImage {
        &self.environment.goal().picture
    }

    /// What it would see on the way there, one picture after the other; the last one is the goal's.
    pub fn goals(&self) -> &[RgbImage] {
        &self.goals
    }

    /// What has to be where.
    pub fn target(&self) -> &Target {
        &self.environment.goal().target
    }

    /// The cameras that there are: how they see, and where from.
    pub fn eyes(&self) -> impl Iterator<Item = (View, &render::Camera)> {
        let front = self.front.as_ref().map(|front| (View::Front, &front.eye));
        std::iter::once((View::Side, self.environment.camera())).chain(front)
    }

    /// The state of the table.
    pub fn world(&self) -> &World {
        self.environment.world()
    }

    /// Back to the start of a task, which is that of [`Self::new`] with this seed. Commands are forgotten.
    ///
    /// # Errors
    /// [`wm_sim::Error::Unsolvable`]: the seed has no such task; everything stays as it is.
    pub fn reset(&mut self, task: GoalKind, seed: u64) -> Result<(), wm_sim::Error> {
        let settings = Settings {
            task,
            seed,
            ..self.settings.clone()
        };
        *self = Self::new(settings)?;
        Ok(())
    }

    /// Takes a velocity, which holds until the next command, but for `command_timeout` at most. Of several in a step,
    /// each counts for its time.
    ///
    /// # Errors
    /// [`CommandError`] says why it is not obeyed; what was told before still holds.
    pub fn twist(&mut self, twist: &TwistStamped, received_ns: i64) -> Result<(), CommandError> {
        let velocity = command::of_twist(twist, &self.settings.base_frame)?;
        self.hold(velocity, received_ns);
        Ok(())
    }

    /// Takes a velocity as six numbers, likewise.
    ///
    /// # Errors
    /// As [`Self::twist`].
    pub fn velocity(
        &mut self,
        array: &Float64MultiArray,
        received_ns: i64,
    ) -> Result<(), CommandError> {
        self.hold(command::of_array(array)?, received_ns);
        Ok(())
    }

    fn hold(&mut self, velocity: Velocity, received_ns: i64) {
        let held = match self.motion {
            Some((Motion::Velocity(held), _)) => held.then(velocity, received_ns),
            _ => Held::new(velocity, received_ns),
        };
        self.motion = Some((Motion::Velocity(held), received_ns));
    }

    /// Takes a motion, to be done once in the next step, and the gripper's opening. What comes between two ticks adds
    /// up: the executor sends several of them in a step.
    ///
    /// # Errors
    /// As [`Self::twist`].
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

    /// Takes where the gripper is to go, 0 closed to 1 open; it holds until it is told something else.
    ///
    /// # Errors
    /// As [`Self::twist`].
    pub fn gripper(&mut self, opening: &Float64) -> Result<(), CommandError> {
        self.gripper = command::of_gripper(opening)?.clamp(0.0, 1.0);
        Ok(())
    }

    /// Does one step of the simulator, 0.2 s, and takes a picture. The first one only looks.
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
            Done { stamp_ns, action }
        });
        self.last_ns = Some(now_ns);
        if let Some((Motion::Velocity(held), _)) = &mut self.motion {
            *held = held.from(now_ns);
        }
        let picture = self.environment.picture();
        let mut lost_pictures = u64::from(!self.camera.take(picture, now_ns));
        if let Some(front) = &mut self.front {
            let picture = self.environment.picture_by(&mut front.renderer);
            lost_pictures += u64::from(!front.camera.take(picture, now_ns));
        }
        let is_solved = self.environment.solved();
        let success = (self.told != Some(is_solved)).then_some(is_solved);
        self.told = Some(is_solved);
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

    /// When the next picture arrives \[ns\], where one is on its way.
    pub fn next_frame_ns(&self) -> Option<i64> {
        let front = self.front.as_ref().and_then(|front| front.camera.next_ns());
        self.camera.next_ns().into_iter().chain(front).min()
    }

    /// The pictures that have arrived by `now_ns`.
    pub fn frames(&mut self, now_ns: i64) -> Vec<Frame> {
        let mut frames = self.camera.arrived(now_ns);
        if let Some(front) = &mut self.front {
            frames.extend(front.camera.arrived(now_ns));
        }
        frames
    }

    /// The clock has jumped: what was told and taken by the old time is forgotten. How many pictures that were.
    pub fn forget(&mut self) -> usize {
        self.motion = None;
        self.last_ns = None;
        let front = self.front.as_mut().map_or(0, |front| front.camera.forget());
        self.camera.forget() + front
    }

    /// What the step since `start_ns` is to do.
    fn command(&mut self, start_ns: i64, now_ns: i64) -> (EndEffectorAction, Option<Problem>) {
        let still = EndEffectorAction::still(self.gripper);
        let Some((motion, said_ns)) = self.motion else {
            return (still, None);
        };
        let age = u64::try_from(now_ns.saturating_sub(said_ns)).map(Duration::from_nanos);
        let is_fresh = age.is_ok_and(|age| age <= self.settings.command_timeout);
        if !is_fresh || matches!(motion, Motion::Delta(_)) {
            self.motion = None;
        }
        let delta = match motion {
            // A client that has fallen silent: that is what the timeout is for.
            Motion::Velocity(_) if !is_fresh => return (still, None),
            Motion::Delta(_) if !is_fresh => {
                let waited_s = now_ns.saturating_sub(said_ns) as f64 / 1e9;
                return (still, Some(Problem::Stale { waited_s }));
            }
            // A step is 0.2 s, whatever the clock says of a tick that is a little late.
            Motion::Velocity(held) => {
                Displacement::of_velocity(held.mean(start_ns, now_ns), STEP_S)
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
