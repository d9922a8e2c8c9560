//! The simulated arm: a live tabletop in place of a WidowX and its camera.
//!
//! [`SimArmStep`] is the node's whole behaviour without DDS and without a clock. It takes the commands of the executor
//! or of any servo client. Each [`SimArmStep::tick`] executes them for one step of the simulator, 0.2 s, and returns
//! the messages of camera and joints.
//!
//! Promises, each with a test:
//! - The same commands and ticks give the same states and pictures.
//! - A velocity holds for at most `command_timeout`; then the arm stands still, and the gripper keeps its opening.
//! - A command that is not finite is refused, and the previous command still holds.
//!
//! Commands of the executor have exactly the effect of its actions in [`wm_sim::Environment`]: a turn changes roll,
//! pitch and yaw, as in the simulator's recordings. Only from the upright pose is it a turn about the base's axes.

mod camera;
mod command;
mod message;
mod node;
mod outlets;
mod parameters;
mod step;
mod time;

pub use camera::{CameraSettings, Frame, View};
pub use command::CommandError;
pub use node::NODE;
pub use step::{Problem, Settings, SimArmStep, StepMotion, Tick};
