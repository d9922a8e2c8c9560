//! The simulated arm: a tabletop that lives, in place of a WidowX and its camera.
//!
//! [`SimArmStep`] is the node's whole behaviour without DDS and without a clock. It takes the commands that the executor
//! sends (or any servo client), and at each [`SimArmStep::tick`] does what they say for one step of the simulator, 0.2 s,
//! and tells what the camera and the joints would.
//!
//! Promises, each with a test:
//! - The same commands and ticks give the same states and pictures.
//! - A velocity holds for `command_timeout` at most; then the arm stands still, and the gripper keeps its opening.
//! - What is not finite is refused, and what came before goes on.
//!
//! What the commands of the executor do here is exactly what its actions do in [`wm_sim::Environment`]: a turn is taken
//! as changes of roll, pitch and yaw, as the simulator's recordings have it. That is a turn about the base's axes only
//! for a hand that is not turned yet.

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
pub use step::{Done, Problem, Settings, SimArmStep, Tick};
