//! The encoder node: camera images in, latents out.
//!
//! [`EncoderStep`] is the node without its ROS interface. `/camera/image_raw` and its `/compressed` sibling carry the
//! same frames; the node takes either, and if a frame arrives on both, only the first.

mod choice;
mod node;
mod other_transports;
mod repeats;
mod step;

pub use choice::{Choice, Fate, Mode, Needs};
pub use node::{NODE, body};
pub use step::{EncoderError, EncoderStep};
