//! The encoder node: camera images in, latents out.
//!
//! [`EncoderStep`] is the node without its wires. `/camera/image_raw` and its `/compressed` sibling carry the same
//! frames; the node takes either, and of a frame that comes by both ways only the first.

mod node;
mod repeats;
mod step;

pub use node::{NODE, body};
pub use step::{EncoderError, EncoderStep};
