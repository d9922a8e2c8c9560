//! A small simulated tabletop with a WidowX-250-like arm, in place of the real arm: it makes
//! Bridge-style bags to train and test world models with.
//!
//! An [`Episode`] is made from one seed: a table with one to four objects and up to two mats, a scripted
//! teleoperator who pushes, grasps, lifts and places things or moves freely, and a 256 by 256 picture every
//! 0.2 s, with the 7-d end-effector action taken then. The same seed and options give the same bytes.
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
//! An [`Environment`] is such a table for closed-loop control: a goal to reach, to push to or to pick and place,
//! its picture and words, one action at a time, and whether the goal is attained.
//!
//! # What holds
//! - The motion from one frame to the next is exactly the recorded action: the operator's lag, tremor
//!   and pauses are in the action, and what the limits or a contact took away from the command is taken
//!   away from the record.
//! - The arm's link lengths and kinematics are those of the WidowX-250 with six joints ([`arm`]).
//!
//! # What it is not
//! A physics engine: contact is quasi-static (no inertia, no bouncing, objects right themselves as they
//! drop), and joints have no limits but reach. The camera is free of noise and still within an episode, and
//! episodes differ only as much as [`Variety`] says, so that a small model can learn them.

mod arguments;
pub mod arm;
mod attempt;
mod bag;
mod dataset;
mod environment;
mod episode;
mod error;
mod gripper;
mod layout;
mod links;
pub mod message;
pub mod object;
pub mod render;
mod room;
mod scene;
mod teleop;
mod urdf;
mod variety;
mod world;

pub use arguments::SimArgs;
pub use bag::{
    ACTION_TOPIC, BASE_FRAME, CAMERA_FRAME, CAMERA_TOPIC, FRAME_PERIOD_NS, GRIPPER_TOPIC,
    INSTRUCTION_TOPIC, LABELS_TOPIC, MASK_TOPIC, POSE_TOPIC, START_NS, SUCCESS_TOPIC, write_bag,
};
pub use dataset::generate_bags;
pub use environment::{
    Environment, Goal, GoalKind, JOINT_NAMES, PLACE_TOLERANCE_M, REACH_TOLERANCE_M, Snapshot,
    Target,
};
pub use episode::{Episode, EpisodeOptions, FRAMES, Frame};
pub use error::Error;
pub use scene::{FIRST_OBJECT_MASK, GRIPPER_MASK, Scene};
pub use teleop::{Failure, LARGEST_STEP_M, LARGEST_TURN_RAD, Relation, Task};
pub use urdf::{LinkFrame, link_frames, urdf};
pub use variety::{Span, Variety};
pub use world::{EndEffectorAction, LARGEST_RPY, STEP_S, WORKSPACE_M, World};
