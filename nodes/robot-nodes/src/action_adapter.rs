//! The action adapter: what an arm publishes in, `wm_msgs/Action` out, for arms that do not publish it.
//!
//! [`AdapterStep`] is the node's whole behaviour without DDS and without a clock. It takes velocities, poses or transforms,
//! and the gripper, and makes one action a period: the displacement of the end effector in that time, stamped with the
//! period's beginning, as a frame's action leads from it to the next one.
//!
//! Promises, each with a test:
//! - The actions of consecutive periods add up to the whole motion, whatever the rate and the phase of the messages.
//! - Only stamps count: messages that come later give the same actions.
//! - For a period of which nothing is known, nothing is published; how many there were is counted.
//! - Values that are not finite, rotations that are none, other frames, and poses that the arm cannot reach in the time are
//!   dropped by name, and what came before still counts.

mod gripper;
mod node;
mod outlets;
mod parameters;
mod poses;
mod problem;
mod speeds;
mod step;
mod twists;

pub use gripper::GripperSource;
pub use node::NODE;
pub use problem::Problem;
pub use speeds::Speeds;
pub use step::{AdapterStep, Done, MotionSource, Settings};
