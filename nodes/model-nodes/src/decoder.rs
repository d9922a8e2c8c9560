//! The decoder node: predicted latents in, pictures out.
//!
//! [`DecoderStep`] is the node without its ROS interface. A picture has the stamp of its prediction: the predicted
//! time.

mod camera_view;
mod node;
mod rollout_buffer;
mod rollouts;
mod step;

pub use node::NODE;
pub use step::{DecoderError, DecoderStep};
