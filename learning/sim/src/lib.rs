//! A small simulated tabletop with a WidowX-250-like arm in place of a real one: it makes Bridge-style bags for training and
//! testing world models.
//!
//! An [`Episode`] is made from a seed: a table with one to four objects and up to two mats, a scripted teleoperator who
//! pushes, grasps, lifts and places objects or moves freely, and every 0.2 s a 256 by 256 picture with the 7-d end-effector
//! action taken there. The same seed and options give the same bytes.
//!
//! ```
//! use wm_sim::{Episode, EpisodeOptions};
//!
//! # fn main() -> Result<(), wm_sim::Error> {
//! let episode = Episode::generate(12, &EpisodeOptions { frames: 5, ..EpisodeOptions::default() })?;
//! println!("{}: {:?}", episode.instruction, episode.frames[0].action);
//! # Ok(())
//! # }
//! ```
//!
//! An [`Environment`] is such a table for closed-loop control: a goal (reach, push, or pick and place) as a picture and
//! words, one action at a time, and whether the goal is attained.
//!
//! # Invariants
//! - The motion between frames is exactly the recorded action: it includes the operator's lag, tremor and pauses, and the
//!   reductions by limits and contacts.
//! - The arm's link lengths and kinematics are those of the WidowX-250 with six joints.
//!
//! # Limits
//! It is not a physics engine: contact is quasi-static (no inertia, no bouncing; falling objects right themselves), and
//! joints have no limits except reach. The camera has no noise and does not move within an episode, and episodes differ
//! only as much as [`Variety`] specifies, so that a small model can learn them.

mod arguments;
mod arm;
mod attempt;
mod bag;
mod dataset;
mod environment;
mod episode;
mod episode_options;
mod error;
mod gripper;
mod layout;
mod links;
pub mod message;
mod object;
pub mod render;
mod room;
mod scene;
mod teleop;
mod urdf;
mod variety;
mod world;

pub use arguments::SimArgs;
pub use arm::ToolPose;
pub use bag::{
    BASE_FRAME, CAMERA_FRAME, FRAME_PERIOD_NS, INSTRUCTION_TOPIC, START_NS, SUCCESS_TOPIC,
};
pub use dataset::generate_bags;
pub use environment::{
    Environment, Goal, GoalKind, JOINT_NAMES, Performance, REACH_TOLERANCE_M, ScriptedPolicy,
    Snapshot, Target,
};
pub use episode::{Episode, Frame};
pub use episode_options::EpisodeOptions;
pub use error::Error;
pub use teleop::{LARGEST_STEP_M, LARGEST_TURN_RAD};
pub use urdf::{LinkFrame, link_frames, urdf};
pub use variety::Variety;
pub use world::{EndEffectorAction, STEP_S, WORKSPACE_M, World};
