//! The action adapter: an arm's poses, velocities, transforms or joints in, `wm_msgs/Action` out, for arms that do not
//! publish it.
//!
//! [`AdapterStep`] is the node's whole behaviour without DDS and without a clock. It takes velocities, poses, transforms or
//! joints, and the gripper, and makes one action a period: the displacement of the end effector in that time, or what the
//! joints did, stamped with the period's beginning, as a frame's action leads from it to the next one.
//!
//! Promises, each with a test:
//! - The actions of consecutive periods add up to the whole motion, whatever the rate and the phase of the messages.
//! - Only stamps count: late messages give the same actions.
//! - So do those of joints, which move evenly from one message to the next.
//! - For a period without data, nothing is published; such periods are counted.
//! - Values that are not finite, invalid rotations, other frames, and poses that the arm cannot reach in the time are dropped
//!   by name; earlier messages still count.

mod gripper;
mod joints;
mod node;
mod outlets;
mod parameters;
mod period;
mod poses;
mod problem;
mod speeds;
mod stamp;
mod step;
mod twists;

pub use gripper::GripperSource;
pub use joints::{JointSpace, NotOfJoints};
pub use node::NODE;
pub use problem::Problem;
pub use speeds::Speeds;
pub use step::{AdapterStep, Done, MotionSource, Motions, Settings};
